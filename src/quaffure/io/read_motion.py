"""Motion from a file of any format that is read here."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.character import Character, CharacterAnimation
from quaffure.body.character_clip import animation_of, character_clip
from quaffure.body.joint_map import JointMap, joint_map_from
from quaffure.body.motion import Motion
from quaffure.body.own_motion import is_own, own_motion
from quaffure.body.retargeting import RETARGET_FPS, retarget_bvh
from quaffure.errors import InputError, refused
from quaffure.hair.character_morphs import surface_morphs
from quaffure.input_file import check_input_file, file_and_clip, read_toml
from quaffure.io.amass import read_amass
from quaffure.io.bvh import read_bvh
from quaffure.io.read_character import CHARACTER_SUFFIXES, read_character
from quaffure.npz import array_names, read_numbers
from quaffure.types import Float, Tensor

SKELETON_SUFFIXES = (".bvh", *CHARACTER_SUFFIXES)
"""Files with a skeleton of their own, which is retargeted."""
MOTION_SUFFIXES = (*SKELETON_SUFFIXES, ".npz")


def read_motion(path: Path, body: BodyModel, joints: Path | None = None) -> Motion:
    """The motion in a file, on the body's joints; its suffix, in any case, selects the format.

    `.bvh` is retargeted from any skeleton whose joints are known by name or by a map; so is an animation of a character
    (`.glb`, `.gltf`, `.fbx`), which `FILE.glb#NAME` or `FILE.glb#0` selects where it has several, and which a body that
    was imported from the character takes exactly. An `.npz` with `body_pose` [F,81] and `fps` (such as a drape file) is
    taken as it is, with `body_translation` [F,3] where it has one; any other `.npz` is read as AMASS or SMPL-X. The
    motion is called after the file.

    Args:
        joints: a joint map (.toml) for a file of `SKELETON_SUFFIXES` (`quaffure.body.joint_map`).

    Raises:
        InputError: no such file, a suffix without a reader, or what the format's reader refuses.
    """
    supported = f"a motion file ({', '.join(MOTION_SUFFIXES)})"
    path, clip = file_and_clip(path)
    check_input_file(path, supported)
    suffix = path.suffix.lower()
    if suffix not in MOTION_SUFFIXES:
        raise InputError(path, supported, f"suffix {path.suffix!r}")
    if joints is not None and suffix not in SKELETON_SUFFIXES:
        raise InputError(joints, f"a joint map for a file of {', '.join(SKELETON_SUFFIXES)}", f"the motion {path}")
    joint_map = None if joints is None else read_joint_map(joints)
    if suffix in CHARACTER_SUFFIXES:
        character = read_character(path)
        animation = animation_of(character, clip)
        name = f"{path.stem}_{animation.name}" if len(character.animations) > 1 else path.stem
        if joint_map is None and is_own(body, character):
            motion = own_motion(character, animation, body, RETARGET_FPS)
            motion = replace(motion, morphs=surface_morphs(character, animation, body, motion.times))
        else:
            motion = retarget_character(character, animation, body, joint_map)
        return replace(motion, name=re.sub(r"[^\w.-]+", "_", name))  # files are named after motions
    if suffix == ".bvh":
        return replace(retarget_bvh(read_bvh(path), body, joint_map), name=path.stem)
    return replace(_read_npz_motion(path, body), name=path.stem)


def retarget_character(
    character: Character, animation: CharacterAnimation, body: BodyModel, joint_map: JointMap | None = None
) -> Motion:
    """An animation of a character on the body's joints, from its first key on, at 30 fps.

    Raises:
        InputError: as `retarget_bvh`.
    """
    clip = character_clip(character, animation, RETARGET_FPS)
    return replace(retarget_bvh(clip, body, joint_map, drops_lead_in=False), start=animation.span[0])


def read_joint_map(path: Path) -> JointMap:
    """The joint map in a TOML file.

    Raises:
        InputError: it cannot be read, is no TOML, or names joints that the body lacks.
    """
    tables = read_toml(path, "a joint map (.toml)")
    with refused(path, "a joint map (.toml)", ValueError):  # numbers too long for Python to write
        return joint_map_from(tables, str(path))


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
