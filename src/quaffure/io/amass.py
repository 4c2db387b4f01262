"""Reads AMASS-style motion: an `.npz` with `poses`, the joint rotations of SMPL, SMPL-H or SMPL-X, and a frame rate.

All three models start with the same 22 joints; fingers, jaw and eyes that follow are not used. `trans`, where a file
has it, is the path of the pelvis in metres. AMASS's world is z up while SMPL's rest pose is y up and faces +z: the
root's rotation holds the change of axes. Files made for y-up tools lack it; they are recognised by the pelvis, whose
own up axis then points along the world's y (mean above `Y_UP_COSINE`).
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import MAX_FRAMES, Motion, filter_flips, resample
from quaffure.body.pose_limits import check_body_pose
from quaffure.body.retargeting import (
    BODY_FROM_Y_UP,
    RETARGET_FPS,
    align_bone,
    body_bone,
    local_pose,
    read_rig,
    source_rotation,
)
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle
from quaffure.npz import read_numbers
from quaffure.types import BodyPose

# SMPL's body joints, in the order of `poses`, and each one's parent.
SMPL_JOINTS = (
    ("pelvis", -1), ("left_hip", 0), ("right_hip", 0), ("spine1", 0), ("left_knee", 1), ("right_knee", 2),
    ("spine2", 3), ("left_ankle", 4), ("right_ankle", 5), ("spine3", 6), ("left_foot", 7), ("right_foot", 8),
    ("neck", 9), ("left_collar", 9), ("right_collar", 9), ("head", 12), ("left_shoulder", 13),
    ("right_shoulder", 14), ("left_elbow", 16), ("right_elbow", 17), ("left_wrist", 18), ("right_wrist", 19),
)  # fmt: skip
FRAME_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate")
Y_UP_COSINE = 0.8
FRAMES_AT_ONCE = 4096

# Of SMPL's T pose: the arms lie along x to within a few degrees.
REST_ARM_DIRECTION = {"Left": (1.0, 0.0, 0.0), "Right": (-1.0, 0.0, 0.0)}


SMPL_BODY = read_rig("smpl")


def read_amass(path: Path, body: BodyModel) -> Motion:
    """The motion of an AMASS file on the body's joints at 30 fps, joint flips repaired.

    Raises:
        InputError: not an `.npz`, no `poses` [1 <= F <= MAX_FRAMES, >= 66] or frame rate in it, a number that is not
            finite, or a rotation beyond 4 pi.
    """
    arrays = read_numbers(path, ("poses", "trans", *FRAME_RATE_KEYS))
    if "poses" not in arrays:
        raise InputError(path, "an array poses [frames, 66 or more], as in AMASS", "none")
    poses = _poses(path, arrays["poses"])
    z_up_from_file = _z_up_from_file(poses)
    translation = None
    if "trans" in arrays:
        translation = _translation(path, arrays["trans"], len(poses), z_up_from_file, body)
    # Some frames at a time: rotation matrices of a frame take 5 times the memory of its pose.
    parts = [_on_body(part, z_up_from_file, body) for part in poses.split(FRAMES_AT_ONCE)]
    motion = Motion(torch.cat(parts), _frame_rate(path, arrays), str(path), translation)
    return resample(filter_flips(motion), RETARGET_FPS)


def _poses(path: Path, poses: np.ndarray) -> Float[Tensor, "f 66"]:
    """Axis-angles of the joints that all three models have."""
    if poses.ndim != 2 or not 1 <= poses.shape[0] <= MAX_FRAMES or poses.shape[1] < 66:
        raise InputError(path, f"poses [1 to {MAX_FRAMES} frames, 66 or more]", f"shape {list(poses.shape)}")
    joints = torch.from_numpy(poses[:, :66].astype(np.float64))
    check_body_pose(joints, str(path))
    return joints


def _frame_rate(path: Path, arrays: dict[str, np.ndarray]) -> float:
    rates = [arrays[key] for key in FRAME_RATE_KEYS if key in arrays]
    if not rates or rates[0].size != 1:
        raise InputError(path, f"one number {' or '.join(FRAME_RATE_KEYS)}", "none" if not rates else "several")
    return float(rates[0].reshape(()))


def _z_up_from_file(poses: Float[Tensor, "f 66"]) -> Float[Tensor, "3 3"]:
    pelvis_up = matrix_from_axis_angle(poses[:, :3])[:, :, 1].mean(0)
    return BODY_FROM_Y_UP if float(pelvis_up[1]) > Y_UP_COSINE else torch.eye(3, dtype=torch.float64)


def _translation(
    path: Path, trans: np.ndarray, frames: int, z_up_from_file: Float[Tensor, "3 3"], body: BodyModel
) -> Float[Tensor, "f 3"]:
    """From the body's rest position, so that its pelvis is where the file's is [m]."""
    if trans.shape != (frames, 3) or not np.isfinite(trans).all():
        raise InputError(path, f"finite trans [{frames}, 3]", f"shape {list(trans.shape)}, or NaN or infinity in it")
    pelvis = torch.from_numpy(trans.astype(np.float64)) @ z_up_from_file.T
    return (pelvis - body.rest_joints[0].double()).float()


def _world_rotations(local: Float[Tensor, "f 22 3 3"]) -> dict[str, Float[Tensor, "f 3 3"]]:
    """World rotations (z up) of SMPL's joints by name, relative to rest frames aligned with the body's axes."""
    world: list[Tensor] = []
    for joint, (_, parent) in enumerate(SMPL_JOINTS):
        world.append(local[:, joint] if parent < 0 else world[parent] @ local[:, joint])
    return {name: rotation @ BODY_FROM_Y_UP.T for (name, _), rotation in zip(SMPL_JOINTS, world)}


def _on_body(poses: Float[Tensor, "f 66"], z_up_from_file: Float[Tensor, "3 3"], body: BodyModel) -> BodyPose:
    """Poses of the body; see the formula in `quaffure.body.retargeting`."""
    local = matrix_from_axis_angle(poses.unflatten(-1, (22, 3)))
    local[:, 0] = z_up_from_file @ local[:, 0]
    world = _world_rotations(local)
    rotations: dict[str, Tensor] = {}
    for name, source in SMPL_BODY.items():
        rotation = source_rotation(source, world)
        if source.bone_ends is not None:
            direction = REST_ARM_DIRECTION["Left" if name.startswith("Left") else "Right"]
            bone = body_bone(body, name, source.bone_ends[0])
            rotation = rotation @ align_bone(bone, torch.tensor(direction, dtype=torch.float64))
        rotations[name] = rotation
    return local_pose(rotations, body)
