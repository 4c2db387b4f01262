"""Retargeting of another skeleton's motion to the body's 27 joints.

Rotations are transferred, and the path of the hips in metres, level with the body's own standing height.

Per joint, with world rotations G relative to rest frames that are aligned with the world:
    G_target = G_source A,    A = R S(target's rest bone, R^T source's rest bone) on arms and legs, else 1
    local    = G_target_parent^T G_target
S(a, b) is the shortest arc from a to b. R takes an arm from a T pose to the source's rest pose: the arc from the body's
side to the source's upper arm, and 1 on legs. With A, limbs point where the source's do; with R, their twist does not
depend on whether the source rests in a T pose, an A pose or with hanging arms.
"""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.bvh_clip import BvhClip
from quaffure.body.joint_map import LIMB_BONES, SIDES, JointMap
from quaffure.body.joint_names import automatic_joint_map, check_joint_map
from quaffure.body.motion import Motion, filter_flips, pose_from_matrices, resample
from quaffure.body.source_skeleton import SourceSkeleton, source_skeleton
from quaffure.geometry.rotation import shortest_arc

RETARGET_FPS = 30.0
# The CMU conversions start from the T pose and reach the actor's own pose within 15 frames of 1/120 s.
LEAD_IN_SECONDS = 0.125
# Metres in one unit of a file; a skeleton whose size fits none is scaled to the body's.
UNITS, UNIT_TOLERANCE = (1.0, 0.01, 0.001, 0.0254), 1.3
REST_POSE_ANGLE = 0.02  # rad; a joint rotated by less than this is in the rest pose


def retarget_bvh(
    clip: BvhClip, body: BodyModel, joint_map: JointMap | None = None, drops_lead_in: bool = True
) -> Motion:
    """The clip on the body's joints at 30 fps: lead-in from the rest pose dropped, joint flips repaired.

    Any skeleton with hips, a spine, a head, arms and legs, of any up axis, facing and unit. The first 0.125 s are
    dropped where the clip starts in its rest pose and is longer than that; the motion's `start` is then after them.

    Args:
        joint_map: which joints are which; by their names without one (`quaffure.body.joint_names`).
        drops_lead_in: without it, all frames are kept.

    Raises:
        InputError: joints cannot be matched (the map as far as it is known is listed), no standing pose shows which
            axes are up and left, or a bone that must be aligned has no length.
    """
    if joint_map is None:
        joint_map = automatic_joint_map(clip)
    else:
        check_joint_map(joint_map, clip)
    dropped = _lead_in_frames(clip, joint_map) if drops_lead_in else 0
    skeleton = source_skeleton(replace(clip, values=clip.values[dropped:]), joint_map)
    rotations = {joint: source.rotation(skeleton.world) for joint, source in joint_map.items()}
    pose, path = aligned_pose(rotations, skeleton, body), _root_translation(skeleton, joint_map, body)
    motion = Motion(pose, clip.fps, clip.source, path, skeleton.notes, start=dropped / clip.fps)
    return resample(filter_flips(motion), RETARGET_FPS)


def aligned_pose(
    source_rotations: dict[str, Float[Tensor, "f 3 3"]], skeleton: SourceSkeleton, body: BodyModel
) -> Float[Tensor, "f 81"]:
    """Body poses of a source's world rotations, by joint of the body: limbs point where the source's do."""
    rotations = {
        joint: rotation @ rest_alignment(joint, skeleton, body)
        for joint, rotation in source_rotations.items()
        if not joint.endswith("FingerBase")
    }
    for side in SIDES:  # a missing foot is fixed to the source's shin, whose bone may point elsewhere than the body's
        rotations.setdefault(f"{side}Foot", source_rotations[f"{side}Leg"])
    return local_pose(rotations, body)


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


def rest_alignment(joint: str, skeleton: SourceSkeleton, body: BodyModel) -> Float[Tensor, "3 3"]:
    """A of the module's formula: the rotation of a joint in the source's rest pose from its own."""
    if joint not in skeleton.bones:
        return torch.eye(3, dtype=torch.float64)
    bone = torch.from_numpy(skeleton.bones[joint])
    raised = torch.eye(3, dtype=torch.float64)
    side = joint.removesuffix("Hand").removesuffix("ForeArm").removesuffix("Arm")
    if side != joint:
        outward = torch.tensor([1.0 if side == "Left" else -1.0, 0.0, 0.0], dtype=torch.float64)
        raised = align_bone(outward, torch.from_numpy(skeleton.bones[f"{side}Arm"]))
    return raised @ align_bone(body_bone(body, joint, LIMB_BONES[joint]), raised.mT @ bone)


def _root_translation(skeleton: SourceSkeleton, joint_map: JointMap, body: BodyModel) -> Float[Tensor, "f 3"] | None:
    """Translation of the body from its rest position [m]: its pelvis is where the file's is.

    Heights count from standing: legs of another length than the actor's must not lift the feet or sink them.
    """
    if skeleton.hips_path is None:
        return None
    scale = _metres_per_unit(skeleton, joint_map, body)
    ankle = float(body.rest_joints[body.joint_names.index("LeftFoot"), 2])
    leg = scale * skeleton.leg if skeleton.leg is not None else float(body.rest_joints[0, 2]) - ankle
    standing = torch.tensor([*body.rest_joints[0, :2].tolist(), leg + ankle], dtype=torch.float64)
    return (scale * skeleton.hips_path - standing).float()


def _metres_per_unit(skeleton: SourceSkeleton, joint_map: JointMap, body: BodyModel) -> float:
    """The known unit that makes the skeleton about as large as the body, or the scale that makes it just as large."""
    spine = float(np.linalg.norm(skeleton.rest[joint_map["Head"].first]))
    scale = float(body_bone(body, "Hips", "Head").norm()) / spine
    fitting = [unit for unit in UNITS if 1 / UNIT_TOLERANCE < unit / scale < UNIT_TOLERANCE]
    return fitting[0] if fitting else scale


def _lead_in_frames(clip: BvhClip, joint_map: JointMap) -> int:
    """Number of frames to drop at the start."""
    arms = [clip.joint_names.index(joint_map[f"{side}{joint}"].first) for side in SIDES for joint in ("Arm", "ForeArm")]
    first = replace(clip, values=clip.values[:1]).local_rotations()
    angles = Rotation.from_matrix(first[0, arms]).magnitude()
    starts_at_rest = bool((angles < REST_POSE_ANGLE).all())
    frames = round(LEAD_IN_SECONDS * clip.fps)
    return frames if starts_at_rest and frames < len(clip.values) else 0
