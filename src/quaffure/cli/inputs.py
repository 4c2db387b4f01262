"""What a user types for a motion or a body shape, read."""

from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.clips import CLIP_NAMES, bundled_clip
from quaffure.body.motion import Motion, resample
from quaffure.errors import InputError
from quaffure.io.npz_strands import read_npz
from quaffure.io.read_motion import read_motion
from quaffure.training.pose_sampler import FPS
from quaffure.types import Float, Tensor

MAX_COEFFICIENT = 10.0  # standard deviations; beyond it nothing human is left


def motion_of(text: str, body: BodyModel) -> Motion:
    """A bundled clip by name, or the motion in a file, at 30 frames per second.

    Raises:
        InputError: neither; or what the file's reader refuses.
    """
    if text in CLIP_NAMES:
        return bundled_clip(text, body)
    if not Path(text).suffix:
        raise InputError(f"motion '{text}'", f"a file or one of {', '.join(CLIP_NAMES)}", "neither")
    return resample(read_motion(Path(text), body), FPS)


def body_shape_of(text: str) -> Float[Tensor, "10"]:
    """Shape coefficients from numbers separated by commas, from a text file of them, or from an .npz's `body_shape`.

    Raises:
        InputError: not ten finite numbers of a size that a body can have.
    """
    if not text:
        return torch.zeros(10)
    path = Path(text)
    if path.suffix == ".npz":
        arrays = read_npz(path, ("body_shape",))
        values = arrays.get("body_shape", np.empty(0)).flatten()
    else:
        if path.suffix in (".txt", ".csv") and not path.is_file():
            raise InputError(path, "a file of ten shape coefficients", "no such file")
        numbers = path.read_text() if path.is_file() else text
        try:
            values = np.array([float(number) for number in numbers.replace(",", " ").split()])
        except (ValueError, UnicodeDecodeError) as error:
            raise InputError(f"shape '{text}'", "ten numbers", str(error)) from error
    if values.shape != (10,):
        raise InputError(f"shape '{text}'", "10 coefficients", f"{values.size}")
    if not (np.abs(values) <= MAX_COEFFICIENT).all():
        raise InputError(f"shape '{text}'", f"coefficients within +-{MAX_COEFFICIENT:g}", f"{values.tolist()}")
    return torch.tensor(values, dtype=torch.float32)
