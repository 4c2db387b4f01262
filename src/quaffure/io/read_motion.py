"""Motion from a file of any format that is read here."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.joint_map import JointMap, joint_map_from
from quaffure.body.motion import Motion
from quaffure.body.retargeting import retarget_bvh
from quaffure.errors import InputError, refused
from quaffure.input_file import check_input_file, read_text
from quaffure.io.amass import read_amass
from quaffure.io.bvh import read_bvh
from quaffure.npz import array_names, read_numbers
from quaffure.types import Float, Tensor


def read_motion(path: Path, body: BodyModel, joints: Path | None = None) -> Motion:
    """The motion in a file, on the body's joints; its suffix, in any case, selects the format.

    `.bvh` is retargeted from any skeleton whose joints are known by name or by a map. An `.npz` with `body_pose` [F,81]
    and `fps` (such as a drape file) is taken as it is, with `body_translation` [F,3] where it has one; any other `.npz`
    is read as AMASS or SMPL-X. The motion is called after the file.

    Args:
        joints: a joint map (.toml) for a .bvh file (`quaffure.body.joint_map`).

    Raises:
        InputError: no such file, a suffix without a reader, or what the format's reader refuses.
    """
    supported = f"a motion file ({', '.join(sorted(MOTION_READERS))})"
    check_input_file(path, supported)
    if path.suffix.lower() not in MOTION_READERS:
        raise InputError(path, supported, f"suffix {path.suffix!r}")
    if joints is not None:
        if path.suffix.lower() != ".bvh":
            raise InputError(joints, "a joint map for a .bvh file", f"the motion {path}")
        return replace(retarget_bvh(read_bvh(path), body, read_joint_map(joints)), name=path.stem)
    return replace(MOTION_READERS[path.suffix.lower()](path, body), name=path.stem)


def read_joint_map(path: Path) -> JointMap:
    """The joint map in a TOML file.

    Raises:
        InputError: it cannot be read, is no TOML, or names joints that the body lacks.
    """
    with refused(path, "a joint map (.toml)", tomllib.TOMLDecodeError, RecursionError):
        table = tomllib.loads(read_text(path, "a joint map (.toml)"))
    return joint_map_from(table, str(path))


def _read_npz_motion(path: Path, body: BodyModel) -> Motion:
    if "body_pose" not in (names := array_names(path)) or "global_orient" in names:  # SMPL-X has a body_pose too
        return read_amass(path, body)
    arrays = read_numbers(path, ("body_pose", "fps", "body_translation"))
    if "fps" not in arrays or arrays["fps"].size != 1:
        raise InputError(path, "one number fps with body_pose", "none" if "fps" not in arrays else "several")
    body_pose = _single_precision(arrays["body_pose"])
    translation = None
    if "body_translation" in arrays:
        translation = _single_precision(arrays["body_translation"])
    return Motion(body_pose, float(arrays["fps"].reshape(())), str(path), translation)


def _single_precision(values: np.ndarray) -> Float[Tensor, "..."]:
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which Motion refuses
        return torch.from_numpy(values.astype(np.float32))


MOTION_READERS: dict[str, Callable[[Path, BodyModel], Motion]] = {
    ".bvh": lambda path, body: retarget_bvh(read_bvh(path), body),
    ".npz": _read_npz_motion,
}
