"""Another skeleton in the body's axes (z up, facing -y): its rest pose, and rotations relative to it.

The rest pose is the one of zero rotations where a figure stands in it. In other files (LaFAN1, whose bones then all
point along x) it is the frame in which the figure stands most upright. Up and left come from the figure itself: from
hips to head, and from right to left hips and arms.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from quaffure.body.bvh_clip import BvhClip
from quaffure.body.joint_map import LIMB_BONES, SIDES, JointMap
from quaffure.errors import InputError
from quaffure.geometry.axes import axis_name, nearest_axis
from quaffure.geometry.rotation import shortest_arc
from quaffure.types import Tensor

AXIS_ANGLE, LEG_ANGLE = np.radians(30.0), np.radians(50.0)
"""Standing: the trunk and the line from right to left are this close to axes of the file, and legs to down."""
MOST_TILT = np.radians(40.0)  # of trunk and legs in the frame that is taken for a rest pose, in the mean
FRAMES_TRIED = 400
LARGEST_NUMBER = 1e9  # of any file, in its units or in degrees: products stay far from overflow
END_ANGLE = np.radians(45.0)
"""Largest angle between an End Site and the bone before: beyond it the End Site was made up."""
WORLD_UP_COSINE = 0.8
"""Between the hips' up axis and another axis of the file, in the mean, for that axis to be up in the world."""
STANDING_HEIGHTS = (0.5, 1.4)  # of the hips along that axis, in lengths of a leg
MOST_LYING = 0.4  # height of the hips along the rest pose's own up axis, in lengths of a leg
BODY_FROM_Y_UP = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
"""From files that are y up and face +z: (x, y, z) -> (x, -z, y)."""

Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class SourceSkeleton:
    """A skeleton with its motion, in the body's axes and the file's unit.

    Attributes:
        rest: positions of the mapped joints at rest, from the hips, by joint of the file.
        bones: unit direction at rest of each limb bone, by joint of the body.
        world: [F,3,3] world rotations relative to the rest pose, by joint of the file.
        hips_path: [F,3] position of the hips in the world; None where the file has no path.
        leg: height of the hips above the left foot at rest; None without feet.
        notes: what was guessed and is unusual, in words.
        body_from_file: rotation from the rest pose's axes to the body's.
    """

    rest: dict[str, Vector]
    bones: dict[str, Vector]
    world: dict[str, Float[Tensor, "f 3 3"]]
    hips_path: Float[Tensor, "f 3"] | None
    leg: float | None
    notes: tuple[str, ...]
    body_from_file: Float[np.ndarray, "3 3"]


def source_skeleton(clip: BvhClip, joint_map: JointMap) -> SourceSkeleton:
    """The clip's skeleton and motion.

    Raises:
        InputError: a figure that stands neither in the pose of zero rotations nor in a frame; a limb without length.
    """
    _check_size(clip)
    rotations = clip.world_rotations()
    rest, reference, notes = _rest_pose(clip, joint_map, rotations)
    body_from_rest = _body_axes(rest, joint_map, snapped=not notes)
    ends = _ends(clip, reference)
    up = body_from_rest[2]
    world_from_file = body_from_rest
    if notes:
        world_from_file = BODY_FROM_Y_UP.numpy() if abs(up[1]) > abs(up[2]) else np.eye(3)
    rest = {name: body_from_rest @ position for name, position in rest.items()}
    foot = joint_map.get("LeftFoot")
    leg = None if foot is None else float(-rest[foot.first][2])
    hips = clip.joint_names.index(joint_map["Hips"].first)
    path = clip.world_positions(hips, rotations) if clip.has_path(hips) else None
    turned = _turned_world(rotations[:, hips] @ reference[hips].T @ up, path, leg, up)
    if turned is not None:
        world_from_file = _shortest_arc(world_from_file @ turned, np.array([0.0, 0.0, 1.0])) @ world_from_file
        notes = (
            *notes,
            f"the world's {axis_name(turned)} axis is up, though the skeleton is made {axis_name(up)} up",
        )
    elif axis_name(up) != "+y":
        notes = (*notes, f"{axis_name(up)} is up")
    needed = {name: clip.joint_names.index(name) for source in joint_map.values() for name in source.joints}
    world = {
        name: torch.from_numpy(world_from_file @ rotations[:, joint] @ reference[joint].T @ body_from_rest.T)
        for name, joint in needed.items()
    }
    hips_path = None if path is None else torch.from_numpy(path @ world_from_file.T)
    bones = _bones(clip.source, rest, {name: body_from_rest @ end for name, end in ends.items()}, joint_map)
    return SourceSkeleton(rest, bones, world, hips_path, leg, notes, body_from_rest)


def _check_size(clip: BvhClip) -> None:
    for what, numbers in (("offsets", clip.offsets), ("channel values", clip.values)):
        if np.abs(numbers).max(initial=0.0) > LARGEST_NUMBER:
            raise InputError(clip.source, f"{what} within {LARGEST_NUMBER:g}", f"{np.abs(numbers).max():.3g}")


def _rest_pose(
    clip: BvhClip, joint_map: JointMap, rotations: Float[np.ndarray, "f j 3 3"]
) -> tuple[dict[str, Vector], Float[np.ndarray, "j 3 3"], tuple[str, ...]]:
    """Positions of the mapped joints from the hips, world rotations of all joints, and what to say of the pose."""
    names = {name for source in joint_map.values() for name in source.joints}
    hips = clip.joint_names.index(joint_map["Hips"].first)
    joints = {name: clip.joint_names.index(name) for name in names}
    zero = {name: clip.rest_position(joint) - clip.rest_position(hips) for name, joint in joints.items()}
    identity = np.tile(np.eye(3), (len(clip.joint_names), 1, 1))
    if _stands(zero, joint_map):
        return zero, identity, ()
    tried = np.unique(np.linspace(0, len(rotations) - 1, min(FRAMES_TRIED, len(rotations))).astype(int))
    positions = {name: clip.world_positions(joint, rotations)[tried] for name, joint in joints.items()}
    positions = {name: position - positions[joint_map["Hips"].first] for name, position in positions.items()}
    tilt = _tilts(positions, joint_map)
    best = int(tilt.argmin())
    if not tilt[best] < MOST_TILT:
        expected = "a figure that stands in the pose of zero rotations or in one of the frames"
        raise InputError(clip.source, expected, f"trunk and legs {np.degrees(tilt[best]):.0f} degrees askew at least")
    frame = int(tried[best])
    note = f"the rest pose is frame {frame}, in which the figure stands; with all rotations zero it does not"
    return {name: position[best] for name, position in positions.items()}, rotations[frame], (note,)


def _stands(rest: dict[str, Vector], joint_map: JointMap) -> bool:
    """Whether the trunk and the line from right to left are along axes of the file, and the legs point down."""
    up, left = _trunk(rest, joint_map)
    if not all(_angle(line, nearest_axis(line)) < AXIS_ANGLE for line in (up, left)):
        return False
    legs = (_line(rest, joint_map, f"{side}UpLeg", f"{side}Leg") for side in SIDES)
    return all(_angle(leg, -up) < LEG_ANGLE for leg in legs)


def _tilts(positions: dict[str, Float[np.ndarray, "f 3"]], joint_map: JointMap) -> Float[np.ndarray, " f"]:
    """Mean angle of trunk and legs from the vertical in every frame [rad]; y or z is up, whichever fits better."""
    trunk = positions[joint_map["Head"].first]
    up = max(np.eye(3)[1:], key=lambda axis: float((trunk @ axis).mean()))
    legs = [_line(positions, joint_map, f"{side}UpLeg", f"{side}Leg") for side in SIDES]
    return np.mean([_angle(trunk, up), *(_angle(leg, -up) for leg in legs)], axis=0)


def _body_axes(rest: dict[str, Vector], joint_map: JointMap, snapped: bool) -> Float[np.ndarray, "3 3"]:
    """Rotation from the rest pose's axes to the body's: rows are left, back and up. Snapped: to the file's axes."""
    up, left = _trunk(rest, joint_map)
    up = nearest_axis(up)
    left = nearest_axis(left) if snapped else left - left @ up * up
    left = left / np.linalg.norm(left)
    return np.stack([left, np.cross(up, left), up])


def _trunk(rest: dict[str, Vector], joint_map: JointMap) -> tuple[Vector, Vector]:
    """Directions from hips to head, and from right to left."""
    widths = [_line(rest, joint_map, f"Right{joint}", f"Left{joint}") for joint in ("UpLeg", "Arm")]
    return rest[joint_map["Head"].first], np.sum(widths, axis=0)


def _turned_world(
    hips_up: Float[np.ndarray, "f 3"], path: Float[np.ndarray, "f 3"] | None, leg: float | None, up: Vector
) -> Vector | None:
    """The axis that is up in the world, where it is another one than in the rest pose; None otherwise.

    The figure is upright along it, and its hips are as high above zero as they are when one stands: someone who lies
    on the floor is upright along another axis as well, but low.
    """
    mean = hips_up.mean(0)
    axis = nearest_axis(mean)
    if path is None or leg is None or axis @ up > 0.5 or axis @ mean < WORLD_UP_COSINE:
        return None
    low, high = (share * leg for share in STANDING_HEIGHTS)
    is_standing = low < float(np.median(path @ axis)) < high and abs(float(np.median(path @ up))) < MOST_LYING * leg
    return axis if is_standing else None


def _ends(clip: BvhClip, reference: Float[np.ndarray, "j 3 3"]) -> dict[str, Vector]:
    """End Sites at rest, of the joints that have a sensible one."""
    if clip.ends is None:
        return {}
    known = (np.abs(clip.ends) <= LARGEST_NUMBER).all(1) & clip.ends.any(1)  # NaN where there is none
    return {clip.joint_names[joint]: reference[joint] @ clip.ends[joint] for joint in np.flatnonzero(known)}


def _bones(source: str, rest: dict[str, Vector], ends: dict[str, Vector], joint_map: JointMap) -> dict[str, Vector]:
    """Unit direction of every mapped limb bone; a bone without an end has its End Site, or the direction of the bone
    before it."""
    bones: dict[str, Vector] = {}
    before: Vector | None = None
    for joint, end in LIMB_BONES.items():
        if joint not in joint_map:
            continue
        name = joint_map[joint].first
        if joint.endswith(("UpLeg", "Arm")) and not joint.endswith("ForeArm"):
            before = None
        if end in joint_map:
            bone = rest[joint_map[end].first] - rest[name]
            if not bone.any():
                raise InputError(source, f"a bone from {name} to {joint_map[end].first}", "an offset of length 0")
        elif before is None:
            continue
        else:
            site = ends.get(name)
            bone = site if site is not None and _angle(site, before) < END_ANGLE else before
        bones[joint] = before = bone / np.linalg.norm(bone)
    return bones


def _line(rest: dict[str, np.ndarray], joint_map: JointMap, first: str, second: str) -> np.ndarray:
    return rest[joint_map[second].first] - rest[joint_map[first].first]


def _angle(a: Float[np.ndarray, "*#n 3"], b: Float[np.ndarray, "*#n 3"]) -> np.ndarray:
    """Angle between vectors [rad]; pi of a vector without length."""
    norms = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    cosine = np.divide((a * b).sum(-1), norms, out=np.full(np.shape(norms), -1.0), where=norms > 0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _shortest_arc(a: Vector, b: Vector) -> Float[np.ndarray, "3 3"]:
    return shortest_arc(torch.from_numpy(a), torch.from_numpy(b)).numpy()
