"""A character's animation as a clip of its skeleton, from which it is retargeted as motion of a BVH file is.

In a BVH file the frames of joints at rest are those of the file. With W a node's world rotation, and p its position:
    G = W W_rest^T,    local rotation = G_parent^T G,    position channels = G_parent^T (p - p_parent)
"""

import warnings

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from quaffure.body.bvh_clip import CHANNEL_NAMES, BvhClip
from quaffure.body.character import Character, CharacterAnimation
from quaffure.body.character_animation import frame_times, poses_at
from quaffure.body.motion import MAX_FRAMES
from quaffure.errors import InputError
from quaffure.geometry.axes import nearest_axis

ROTATION_CHANNELS = ("Zrotation", "Xrotation", "Yrotation")
POSE_TOLERANCE = 1e-3
"""Within which a pose is another one, in sizes of the figure."""
FLAT = 1e-9
"""Determinant of a matrix, of the cube of its longest column, below which it has no rotation to speak of."""
MOVED = 1e-5
"""Change of an offset that is motion, in lengths of the figure."""


def animation_of(character: Character, name: str = "") -> CharacterAnimation:
    """An animation by its name or its number; the only one without.

    Raises:
        InputError: none of that name, none at all, or several to choose from; lists them.
    """
    animations = {animation.name: animation for animation in character.animations}
    if not animations:
        raise InputError(character.source, "an animation", "none")
    if name in animations:
        return animations[name]
    if name.isdecimal() and len(name) < 10 and int(name) < len(animations):
        return character.animations[int(name)]
    if not name and len(animations) == 1:
        return character.animations[0]
    known = ", ".join(f"#{index} {found}" for index, found in enumerate(animations))
    found = f"'{name}'" if name else f"{len(animations)} without a choice"
    raise InputError(character.source, f"one of its animations (FILE#NAME or FILE#NUMBER): {known}", found)


def character_clip(
    character: Character,
    animation: CharacterAnimation | None,
    fps: float,
    rest: Float[np.ndarray, "n 4 4"] | None = None,
) -> BvhClip:
    """An animation as a clip of the character's joints, at a constant rate from its first key on.

    Args:
        animation: without one, the clip is one frame at rest.
        fps: frames per second.
        rest: `scene_from_node` of every node in the pose of zero rotations; that of `bind_pose` without.

    Raises:
        InputError: too many frames.
    """
    rest = bind_pose(character) if rest is None else rest
    joints = character.joints
    times = np.zeros(1) if animation is None else frame_times(animation, fps, MAX_FRAMES)
    rotations, positions = _turned_and_placed(character, animation, times, rest)
    place = {joint: index for index, joint in enumerate(joints)}
    parents = np.array([place.get(int(character.nodes.parents[joint]), -1) for joint in joints])
    offsets = rest[joints, :3, 3] - np.where(parents[:, None] < 0, 0, rest[joints, :3, 3][parents])
    least = MOVED * max(float(np.ptp(rest[joints, :3, 3], axis=0).max()), 1e-12)
    channels, columns = [], []
    for joint, parent in enumerate(parents):
        turned, moved = rotations[:, joint], positions[:, joint]
        if parent >= 0:
            turned = rotations[:, parent].mT @ turned
            moved = np.einsum("fji,fj->fi", rotations[:, parent], moved - positions[:, parent])
        is_moved = joint == 0 or parent < 0 or np.abs(moved - offsets[joint]).max() > least
        channels.append((*(CHANNEL_NAMES[:3] if is_moved else ()), *ROTATION_CHANNELS))
        columns += [moved] if is_moved else []
        columns.append(_euler_angles(turned))
    return BvhClip(
        joint_names=tuple(character.nodes.names[joint] for joint in joints),
        parents=parents,
        offsets=offsets,
        channels=tuple(channels),
        values=np.concatenate(columns, axis=1),
        frame_time=1 / fps,
        source=character.source if animation is None else f"{character.source}#{animation.name}",
    )


def bind_pose(character: Character) -> Float[np.ndarray, "n 4 4"]:
    """`scene_from_node` when the meshes were bound to their joints, which is a T or an A pose in most files.

    The nodes' own transforms at rest are another pose in some, such as the first frame of an animation. Meshes are
    bound in a space of their own: it is placed where its first joint is, along axes of the scene.
    """
    nodes = character.nodes
    pose, is_bound = nodes.world.copy(), np.zeros(len(nodes), dtype=bool)
    for skin in {id(mesh.skin): mesh.skin for mesh in character.meshes if not mesh.is_rigid}.values():
        matrices = nodes.world[skin.nodes] @ skin.inverse_bind
        size = max(np.abs(matrices[0, :3, :3]).max(), 1e-12)
        reach = float(np.ptp(nodes.world[skin.nodes, :3, 3], axis=0).max())
        is_same = np.abs(matrices[:, :3, :3] - matrices[0, :3, :3]).max() < POSE_TOLERANCE * size
        if is_same or not (np.abs(np.linalg.det(skin.inverse_bind[:, :3, :3])) > 1e-30).all() or reach == 0:
            continue
        top = int(np.argmin(skin.nodes))
        scene_from_mesh = _along_axes(matrices[top])
        bound = scene_from_mesh @ np.linalg.inv(skin.inverse_bind)
        bound[:, :3, 3] += nodes.world[skin.nodes[top], :3, 3] - bound[top, :3, 3]
        free = ~is_bound[skin.nodes]
        pose[skin.nodes[free]], is_bound[skin.nodes[free]] = bound[free], True
    if is_bound.any():
        for node, parent in enumerate(nodes.parents):
            if parent >= 0 and not is_bound[node] and np.linalg.det(nodes.world[parent]) != 0:
                pose[node] = pose[parent] @ np.linalg.inv(nodes.world[parent]) @ nodes.world[node]
    return pose


def _along_axes(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """A matrix of the nearest rotation that takes axes to axes, with the same scale; nothing else."""
    scale = np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    first = nearest_axis(matrix[:3, 0])
    second = nearest_axis(np.where(first != 0, 0, matrix[:3, 1]))
    turned = np.eye(4)
    turned[:3, :3] = scale * np.stack([first, second, np.cross(first, second)], axis=1)
    return turned


def _euler_angles(rotations: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    """Angles about z, x and y [degrees]; where two of them are about one axis, scipy warns and takes 0 for one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return Rotation.from_matrix(rotations).as_euler("ZXY", degrees=True)


def _turned_and_placed(
    character: Character,
    animation: CharacterAnimation | None,
    times: Float[np.ndarray, " f"],
    rest: Float[np.ndarray, "n 4 4"],
) -> tuple[Float[np.ndarray, "f j 3 3"], Float[np.ndarray, "f j 3"]]:
    """Rotations of the joints from rest, and their places; the matrices of all nodes are kept for some frames alone."""
    joints, first = character.joints, 0
    rotations, positions = np.empty((len(times), len(joints), 3, 3)), np.empty((len(times), len(joints), 3))
    for pose in poses_at(character, animation, times):
        world = pose.world[:, joints]
        last = first + len(world)
        rotations[first:last] = _turned(world[..., :3, :3], rest[joints, :3, :3])
        positions[first:last] = world[..., :3, 3]
        first = last
    return rotations, positions


def _turned(world: Float[np.ndarray, "f j 3 3"], rest: Float[np.ndarray, "j 3 3"]) -> Float[np.ndarray, "f j 3 3"]:
    """Rotations from rest to a pose, whatever the scale of each; none of joints that are scaled or sheared flat."""
    lengths = np.linalg.norm(rest, axis=-2).max(-1), np.linalg.norm(world, axis=-2).max(-1)
    flat = (np.abs(np.linalg.det(rest)) < FLAT * lengths[0] ** 3) | (lengths[0] == 0)
    change = world @ np.linalg.inv(np.where(flat[:, None, None], np.eye(3), rest))
    size = np.linalg.det(change)
    usable = ~flat & (size > np.maximum(1e-30, FLAT * np.linalg.norm(change, axis=-2).max(-1) ** 3))
    change = np.where(usable[..., None, None], change, np.eye(3)) / np.cbrt(np.where(usable, size, 1))[..., None, None]
    return Rotation.from_matrix(change.reshape(-1, 3, 3)).as_matrix().reshape(change.shape)
