"""Retargeting of another skeleton's motion to the body's 27 joints.

Rotations are transferred, and the path of the root in metres, level with the body's own standing height.

Per joint, with world rotations G relative to rest frames that are aligned with the world:
    G_target = G_source A,    A = shortest arc from the target's to the source's rest bone on arms and legs, else 1
    local    = G_target_parent^T G_target
With A, arms and legs point where the source's do, though one rests in a T pose and the other in an A pose.
"""

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.bvh_clip import BvhClip
from quaffure.body.motion import Motion, filter_flips, pose_from_matrices, resample
from quaffure.errors import InputError
from quaffure.geometry.rotation import interpolate_rotations, shortest_arc

RETARGET_FPS = 30.0
# The CMU conversions start from the T pose and reach the actor's own pose within 15 frames of 1/120 s.
LEAD_IN_SECONDS = 0.125
# Metres in one unit of a file; a skeleton whose size fits none is scaled to the body's.
UNITS, UNIT_TOLERANCE = (1.0, 0.01, 0.001, 0.0254), 1.3
REST_POSE_ANGLE = 0.02  # rad; a joint rotated by less than this is in the rest pose

# Files are y up and face +z; the body is z up and faces -y: (x, y, z) -> (x, -z, y).
BODY_FROM_Y_UP = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], dtype=torch.float64)


@dataclass(frozen=True)
class JointSource:
    """Source of the world rotation of one joint of the body.

    Attributes:
        sources: joint of the source skeleton, or two of them for the rotation half way between both.
        bone_ends: end joints of the bone in the body and in the source, for joints whose bones are aligned.
    """

    sources: tuple[str, ...]
    bone_ends: tuple[str, str] | None = None


def read_rig(name: str) -> dict[str, JointSource]:
    """Sources of the body's joints in a skeleton of `assets/rigs.toml`; joints without one follow their parents."""
    rig = tomllib.loads((files("quaffure") / "assets" / "rigs.toml").read_text(encoding="utf-8"))[name]
    return {
        joint: JointSource(tuple(source["sources"]), tuple(source["bone_ends"]) if "bone_ends" in source else None)
        for joint, source in rig.items()
    }


DAZ_FRIENDLY_RIG = read_rig("daz_friendly")


def retarget_bvh(clip: BvhClip, body: BodyModel) -> Motion:
    """The clip on the body's joints at 30 fps: lead-in from the rest pose dropped, joint flips repaired.

    The clip is y up and faces +z at rest, in the Daz-friendly rig of the CMU database (cgspeed.com). The first
    0.125 s are dropped where the clip starts in its rest pose and is longer than that.

    Raises:
        InputError: the clip lacks joints (all are listed), is not y up, or a bone that must be aligned has no length.
    """
    _check_joints(clip)
    start = _lead_in_frames(clip)
    world = torch.from_numpy(clip.world_rotations()[start:])
    world = BODY_FROM_Y_UP @ world @ BODY_FROM_Y_UP.T
    source_world = {name: world[:, joint] for joint, name in enumerate(clip.joint_names)}
    target_world = {
        name: source_rotation(source, source_world) @ _bone_alignment(name, source, clip, body)
        for name, source in DAZ_FRIENDLY_RIG.items()
    }
    motion = Motion(local_pose(target_world, body), clip.fps, clip.source, _root_translation(clip, body, start))
    return resample(filter_flips(motion), RETARGET_FPS)


def local_pose(world_rotations: dict[str, Float[Tensor, "f 3 3"]], body: BodyModel) -> Float[Tensor, "f 81"]:
    """Body poses of world rotations by joint name; joints without one follow their parents."""
    identity = torch.eye(3, dtype=torch.float64).expand_as(next(iter(world_rotations.values())))
    world: list[Tensor] = []
    local: list[Tensor] = []
    for name, parent in zip(body.joint_names, body.joint_parents):
        parent_rotation = world[parent] if parent >= 0 else identity
        world.append(world_rotations.get(name, parent_rotation))
        local.append(parent_rotation.mT @ world[-1])
    return pose_from_matrices(torch.stack(local, dim=1))


def align_bone(target_bone: Float[Tensor, "3"], source_bone: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """A of the module's formula: rotates the target's rest bone to the source's; of any length."""
    target, source = (torch.nn.functional.normalize(bone.double(), dim=-1) for bone in (target_bone, source_bone))
    return shortest_arc(target, source)


def body_bone(body: BodyModel, joint: str, end: str) -> Float[Tensor, "3"]:
    """Rest bone from one joint of the body to another [m]."""
    return body.rest_joints[body.joint_names.index(end)] - body.rest_joints[body.joint_names.index(joint)]


def source_rotation(source: JointSource, world: dict[str, Tensor]) -> Float[Tensor, "f 3 3"]:
    """G_source of the module's formula, from the source skeleton's world rotations by joint name."""
    if len(source.sources) == 1:
        return world[source.sources[0]]
    first, second = (world[name] for name in source.sources)
    return interpolate_rotations(first, second, torch.full(first.shape[:1], 0.5, dtype=first.dtype))


def _bone_alignment(name: str, source: JointSource, clip: BvhClip, body: BodyModel) -> Float[Tensor, "3 3"]:
    if source.bone_ends is None:
        return torch.eye(3, dtype=torch.float64)
    body_end, clip_end = source.bone_ends
    offset = torch.from_numpy(_rest_position(clip, clip_end) - _rest_position(clip, source.sources[0]))
    if float(offset.norm()) == 0.0:
        raise InputError(clip.source, f"a bone from {source.sources[0]} to {clip_end}", "an offset of length 0")
    return align_bone(body_bone(body, name, body_end), BODY_FROM_Y_UP @ offset)


def _rest_position(clip: BvhClip, name: str) -> Float[np.ndarray, "3"]:
    """Rest position of a joint relative to the root [file units]."""
    position, joint = np.zeros(3), clip.joint_names.index(name)
    while joint >= 0:
        position, joint = position + clip.offsets[joint], int(clip.parents[joint])
    return position


def _root_translation(clip: BvhClip, body: BodyModel, start: int) -> Float[Tensor, "f 3"] | None:
    """Translation of the body from its rest position [m], from a frame on: its pelvis is where the file's is.

    Heights count from standing: legs of another length than the actor's must not lift the feet or sink them.
    """
    positions = clip.root_positions()
    if positions is None:
        return None
    scale = _metres_per_unit(clip, body)
    pelvis = scale * torch.from_numpy(positions[start:]) @ BODY_FROM_Y_UP.T
    leg = scale * (_rest_position(clip, "hip") - _rest_position(clip, DAZ_FRIENDLY_RIG["LeftFoot"].sources[0]))[1]
    ankle = float(body.rest_joints[body.joint_names.index("LeftFoot"), 2])
    standing = torch.tensor([*body.rest_joints[0, :2].tolist(), leg + ankle], dtype=torch.float64)
    return (pelvis - standing).float()


def _metres_per_unit(clip: BvhClip, body: BodyModel) -> float:
    """The known unit that makes the skeleton about as large as the body, or the scale that makes it just as large."""
    spine = float(np.linalg.norm(_rest_position(clip, "head") - _rest_position(clip, "hip")))
    scale = float(body_bone(body, "Hips", "Head").norm()) / spine
    fitting = [unit for unit in UNITS if 1 / UNIT_TOLERANCE < unit / scale < UNIT_TOLERANCE]
    return fitting[0] if fitting else scale


def _check_joints(clip: BvhClip) -> None:
    sources = DAZ_FRIENDLY_RIG.values()
    needed = {name for source in sources for name in (*source.sources, *(source.bone_ends or ())[1:])}
    missing = sorted(needed - set(clip.joint_names))
    if missing:
        raise InputError(clip.source, "the joints of the CMU Daz-friendly rig", f"none named {', '.join(missing)}")
    up = _rest_position(clip, "head") - _rest_position(clip, "hip")
    if up[1] <= max(abs(up[0]), abs(up[2])):
        raise InputError(clip.source, "a rest pose with the head above the hip along y", f"the head at {up.tolist()}")


def _lead_in_frames(clip: BvhClip) -> int:
    """Number of frames to drop at the start."""
    arms = [clip.joint_names.index(name) for name in ("lShldr", "rShldr", "lForeArm", "rForeArm")]
    angles = Rotation.from_matrix(clip.local_rotations()[0, arms]).magnitude()
    starts_at_rest = bool((angles < REST_POSE_ANGLE).all())
    frames = round(LEAD_IN_SECONDS * clip.fps)
    return frames if starts_at_rest and frames < len(clip.values) else 0
