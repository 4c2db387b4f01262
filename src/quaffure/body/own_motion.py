"""An imported body in the animations of its own character: the file's joints, exactly."""

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.character import Character, CharacterAnimation
from quaffure.body.character_animation import frame_times, poses_at
from quaffure.body.character_clip import character_clip
from quaffure.body.joint_map import JointSource
from quaffure.body.motion import MAX_FRAMES, Motion
from quaffure.body.retargeting import aligned_pose
from quaffure.body.source_skeleton import source_skeleton

TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
"""Joints whose place at rest is the same in the file and in the body."""
SAME_PLACE = 1e-3  # m
STRETCH = 0.01
"""Change of a joint's scale that is said."""


def is_own(body: BodyModel, character: Character) -> bool:
    """Whether a body was imported from this character, or from another file of the same rig at rest."""
    if body.origin is None:
        return False
    names = {name: node for node, name in enumerate(character.nodes.names)}
    for joint, name in enumerate(body.joint_names):
        node = body.origin.joint_nodes[joint]
        if not node:
            continue
        if node not in names:
            return False
        place = body.origin.body_from_file(character.nodes.world[names[node], :3, 3])
        if name in TRUNK and np.linalg.norm(place - body.rest_joints[joint].double().numpy()) > SAME_PLACE:
            return False
    return True


def own_motion(character: Character, animation: CharacterAnimation, body: BodyModel, fps: float) -> Motion:
    """An animation of a body's own character, from its first key on.

    Every joint of the body that is a node of the file has that node's rotation, others follow their parents, and the
    hips are where the file has them. What nodes stretch is left out, and the motion's notes say so;
    `quaffure.hair.character_space` moves hair by it.

    Args:
        body: imported from the character (`is_own`).

    Raises:
        InputError: too many frames.
    """
    origin = body.origin
    assert origin is not None
    joint_map = {joint: JointSource(node) for joint, node in zip(body.joint_names, origin.joint_nodes) if node}
    at_rest = source_skeleton(character_clip(character, None, fps, character.nodes.world), joint_map)
    clip = character_clip(character, animation, fps, character.nodes.world)
    world = clip.world_rotations()
    turned = {
        joint: torch.from_numpy(origin.rotation.T @ world[:, clip.joint_names.index(source.first)] @ origin.rotation)
        for joint, source in joint_map.items()
    }
    hips = clip.world_positions(clip.joint_names.index(joint_map["Hips"].first), world)
    path = origin.body_from_file(hips) - body.rest_joints[0].double().numpy()
    pose = aligned_pose(turned, at_rest, body)
    notes = _stretched(character, animation, fps, {name: joint_map[name].first for name in joint_map})
    return Motion(pose, fps, clip.source, torch.from_numpy(path).float(), notes, animation.span[0])


def _stretched(character: Character, animation: CharacterAnimation, fps: float, own: dict[str, str]) -> tuple[str, ...]:
    """Which joints of the body an animation stretches, which the surface that hair collides with does not follow.

    Args:
        own: node of each joint.
    """
    if not any(channel.path == "scale" for channel in animation.channels):
        return ()
    nodes = [character.nodes.names.index(node) for node in own.values()]
    rest = np.linalg.norm(character.nodes.world[nodes, :3, :3], axis=1)
    largest = np.zeros(len(nodes))
    for poses in poses_at(character, animation, frame_times(animation, fps, MAX_FRAMES)):
        scale = np.linalg.norm(poses.world[:, nodes, :3, :3], axis=2) / np.maximum(rest, 1e-12)
        largest = np.maximum(largest, np.abs(scale - 1).max((0, 2)))
    joints = [joint for joint, change in zip(own, largest) if change > STRETCH]
    size = f"by up to {100 * largest.max():.0f} %: hair collides with the body at its size at rest"
    return (f"scale of {', '.join(joints)} is animated, {size}",) if joints else ()
