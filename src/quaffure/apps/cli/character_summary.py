"""What a character's file holds: meshes, joints and animations."""

from pathlib import Path

import numpy as np

from quaffure.apps.cli.motion_summary import REFUSED, Summary, extent, joint_map_summary, usable_motion
from quaffure.body.body_model import BodyModel
from quaffure.body.character import CharacterAnimation, SkinnedMesh
from quaffure.body.character_clip import character_clip
from quaffure.body.joint_names import check_joint_map, guess_joint_map
from quaffure.errors import InputError
from quaffure.io.read_character import read_character
from quaffure.io.read_motion import read_joint_map


def character_summary(path: Path, body: BodyModel, joints: Path | None = None) -> Summary:
    """What a file of a character holds, and its first animation on the body's joints.

    Args:
        joints: a joint map.

    Raises:
        InputError: it cannot be read.
    """
    character = read_character(path)
    clip = character_clip(character, None, 1.0)
    joint_map, doubts = guess_joint_map(clip) if joints is None else (read_joint_map(joints), [])
    summary: Summary = {
        "kind": "character",
        "nodes": len(character.nodes),
        "joints": len(character.joints),
        "meshes": {mesh.name: _mesh(mesh) for mesh in character.meshes},
        "animations": {animation.name: _animation(animation) for animation in character.animations},
        "extent_units": extent(np.concatenate([mesh.vertices for mesh in character.meshes]))
        if character.meshes
        else None,
        **joint_map_summary(clip, joint_map),
    }
    if character.animations:
        return summary | usable_motion(Path(f"{path}#0"), body, joints)
    try:
        check_joint_map(joint_map, clip, doubts)
    except InputError as error:
        summary[REFUSED] = f"expected {error.expected}, found {error.found}"
    return summary


def _mesh(mesh: SkinnedMesh) -> str:
    parts = [f"{len(mesh.vertices)} vertices", f"{len(mesh.faces)} triangles"]
    parts.append("on its node" if mesh.is_rigid else f"{len(mesh.skin.nodes)} joints")
    if mesh.morph_targets:
        parts.append(f"{len(mesh.morph_targets)} morph targets")
    if mesh.attributes:
        parts.append(f"attributes {', '.join(mesh.attributes)}")
    named = [name for name in mesh.materials if name]
    return ", ".join([*parts, *([f"materials {', '.join(named)}"] if named else [])])


def _animation(animation: CharacterAnimation) -> str:
    first, last = animation.span
    keys = np.unique(np.concatenate([channel.times for channel in animation.channels]))
    steps = np.diff(keys)
    rate = f" at {1 / float(np.median(steps)):.4g} per second" if len(steps) and np.median(steps) > 0 else ""
    moved = len({channel.node for channel in animation.channels})
    return f"{first:.4g} s to {last:.4g} s, {len(keys)} keys{rate}, moves {moved} nodes"
