"""What a user types for a motion or a body shape, read."""

import os
from pathlib import Path

import numpy as np
import torch

from quaffure.apps.cli.console import console
from quaffure.body.body_model import BodyModel
from quaffure.body.calibration_pose import calibration_pose
from quaffure.body.motion import Motion
from quaffure.body.pose_limits import check_body_shape
from quaffure.energies.gravity import Acceleration
from quaffure.errors import InputError
from quaffure.hair.character_space import CharacterSpace
from quaffure.hair.export_clip import ExportSettings
from quaffure.input_file import read_text
from quaffure.io.character_scene import read_character_space
from quaffure.io.load_motion import load_motion
from quaffure.npz import read_numbers
from quaffure.types import Float, Tensor

SHAPE_SUFFIXES = (".csv", ".npz", ".txt")
MAX_ACCELERATION = 100.0  # m/s^2; ten times gravity


def motion_of(text: str, body: BodyModel, in_place: bool = False, joints: Path | None = None) -> Motion:
    """`load_motion`, printing what the file's reader guessed."""
    motion = load_motion(text, body, in_place, joints)
    for note in motion.notes:
        console.print(f"{text}: {note}")
    return motion


def clip_of(text: str, body: BodyModel, in_place: bool, joints: Path | None, frames: str) -> Motion:
    """Some frames of `motion_of`, with a note where a calibration pose is among them."""
    motion = motion_of(text, body, in_place, joints)
    clip = motion.frames(frames)
    pose = calibration_pose(motion, body)
    if pose is not None and round((clip.start - motion.start) * motion.fps) < pose.frames:
        console.print(f"{text}: {pose}")
    return clip


def character_space_of(
    text: str, body: BodyModel, times: Float[np.ndarray, " f"], settings: ExportSettings, joints: Path | None = None
) -> CharacterSpace | None:
    """`read_character_space`, printing where files will be.

    Args:
        joints: a joint map by which the motion was retargeted: it is another one then than the file's own.

    Raises:
        InputError: a skeleton is asked for, too: that of the body is not the character's.
    """
    space = read_character_space(body, text if joints is None else "", times)
    if space is None:
        return None
    if settings.skinned:
        raise InputError("--skinned", "the shipped body, or files without a skeleton", f"that of {space.origin.source}")
    moved = "its own skin moves the roots" if space.skin is not None else "the imported surface moves the roots"
    console.print(f"files for other programs are in the axes and units of {space.origin.source}; {moved}")
    return space


def body_shape_of(text: str) -> Float[Tensor, "10"]:
    """Shape coefficients from numbers separated by commas, a text file of them, or an .npz's `body_shape`.

    Raises:
        InputError: not ten finite numbers of a size that a body can have.
    """
    if not text:
        return torch.zeros(10)
    source = f"shape '{text}'"
    # Not Path.is_file, which raises where the numbers are longer than a name can be.
    names_file = os.path.isfile(text) or Path(text).suffix.lower() in SHAPE_SUFFIXES
    values = _file_numbers(Path(text)) if names_file else _numbers(text, source)
    if values.shape != (10,):
        raise InputError(source, "10 coefficients", f"{values.size}")
    shape = torch.tensor(values, dtype=torch.float32)
    check_body_shape(shape, source)
    return shape


def acceleration_of(text: str, option: str) -> Acceleration:
    """An acceleration X,Y,Z in the world's axes, z up [m/s^2].

    Raises:
        InputError: not three finite numbers of ordinary size.
    """
    values = _numbers(text, option)
    if values.shape != (3,) or not (np.abs(values) <= MAX_ACCELERATION).all():
        raise InputError(option, f"three numbers X,Y,Z within +-{MAX_ACCELERATION:g} m/s^2", f"'{text}'")
    x, y, z = values.tolist()
    return x, y, z


def _file_numbers(path: Path) -> Float[np.ndarray, " n"]:
    if path.suffix.lower() == ".npz":
        return read_numbers(path, ("body_shape",)).get("body_shape", np.empty(0)).flatten()
    return _numbers(read_text(path, "a text file of ten shape coefficients"), path)


def _numbers(text: str, source: str | Path) -> Float[np.ndarray, " n"]:
    try:
        return np.array([float(number) for number in text.replace(",", " ").split()])
    except ValueError as error:
        found = str(error).removeprefix("could not convert string to float: ")
        raise InputError(source, "numbers separated by commas", found) from error
