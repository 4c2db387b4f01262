"""Reads SMPL motion as AMASS and its successors store it: an `.npz` with rotations of the joints, and a frame rate.

Rotations are `poses` of SMPL, SMPL-H or SMPL-X, `root_orient` and `pose_body`, or `global_orient` and `body_pose`. All
models start with the same 22 joints; fingers, jaw and eyes that follow are not used. `trans` or `transl`, where a file
has it, is the path of the pelvis in metres. Arrays of other names, pickled ones too, are left alone.

AMASS's world is z up while SMPL's rest pose is y up and faces +z: the root's rotation holds the change of axes. Files
for y-up tools lack it, and the camera's frame of pose estimators is y down; both are recognised by the pelvis, whose
own up axis then points along the world's y or against it (mean beyond `Y_COSINE`).
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.joint_map import LIMB_BONES, bundled_joint_map
from quaffure.body.motion import MAX_FRAMES, Motion, filter_flips, resample
from quaffure.body.pose_limits import check_body_pose
from quaffure.body.retargeting import RETARGET_FPS, align_bone, body_bone, local_pose
from quaffure.body.source_skeleton import BODY_FROM_Y_UP
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle
from quaffure.npz import array_headers, is_number, read_numbers
from quaffure.types import BodyPose

# SMPL's body joints, in the order of `poses`, and each one's parent.
SMPL_JOINTS = (
    ("pelvis", -1), ("left_hip", 0), ("right_hip", 0), ("spine1", 0), ("left_knee", 1), ("right_knee", 2),
    ("spine2", 3), ("left_ankle", 4), ("right_ankle", 5), ("spine3", 6), ("left_foot", 7), ("right_foot", 8),
    ("neck", 9), ("left_collar", 9), ("right_collar", 9), ("head", 12), ("left_shoulder", 13),
    ("right_shoulder", 14), ("left_elbow", 16), ("right_elbow", 17), ("left_wrist", 18), ("right_wrist", 19),
)  # fmt: skip
ROTATION_KEYS = (("poses",), ("root_orient", "pose_body"), ("global_orient", "body_pose"))
"""Arrays of joint rotations, one after another; the first that a file has are read."""
PATH_KEYS = ("trans", "transl")
FRAME_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")
ROTATION_NUMBERS = 66  # of 22 joints
Y_COSINE = 0.8
FRAMES_AT_ONCE = 4096
BODY_FROM_Y_DOWN = -BODY_FROM_Y_UP * torch.tensor([[-1.0], [1.0], [1.0]], dtype=torch.float64)
"""From the frame of a camera, which x is to the right, y down and z away from: (x, y, z) -> (x, z, -y)."""

# Of SMPL's T pose: the arms lie along x to within a few degrees.
REST_ARM_DIRECTION = {"Left": (1.0, 0.0, 0.0), "Right": (-1.0, 0.0, 0.0)}


SMPL_BODY = bundled_joint_map("smpl")


def read_amass(path: str | Path, body: BodyModel) -> Motion:
    """The motion of an AMASS or SMPL-X file on the body's joints at 30 fps, joint flips repaired.

    Raises:
        InputError: not an `.npz`, no rotations [1 <= F <= MAX_FRAMES, >= 66] or frame rate in it, a number that is not
            finite, or a rotation beyond 4 pi.
    """
    path = Path(path)
    headers = array_headers(path)
    numeric = [name for name, header in headers.items() if is_number(header)]
    rotations = next((keys for keys in ROTATION_KEYS if {*keys} <= {*numeric}), None)
    if rotations is None:
        expected = "arrays of numbers poses [frames, 66 or more], as in AMASS, or root_orient and pose_body, or "
        others = [f"{name} of type {headers[name].dtype}, not plain numbers" for name in headers if name not in numeric]
        found = ", ".join([*sorted(numeric), *others]) or "none"
        raise InputError(path, f"{expected}global_orient and body_pose", found)
    wanted = (*rotations, *PATH_KEYS, *FRAME_RATE_KEYS)
    arrays = read_numbers(path, tuple(name for name in wanted if name in numeric))
    poses = _poses(path, [arrays[key] for key in rotations], " + ".join(rotations))
    z_up_from_file, notes = _z_up_from_file(poses)
    translation = None
    if travels := [arrays[key] for key in PATH_KEYS if key in arrays]:
        translation = _translation(path, travels[0], len(poses), z_up_from_file, body)
    # Some frames at a time: rotation matrices of a frame take 5 times the memory of its pose.
    parts = [_on_body(part, z_up_from_file, body) for part in poses.split(FRAMES_AT_ONCE)]
    motion = Motion(torch.cat(parts), _frame_rate(path, arrays), str(path), translation, notes)
    return resample(filter_flips(motion), RETARGET_FPS)


def _poses(path: Path, parts: list[np.ndarray], names: str) -> Float[Tensor, "f 66"]:
    """Axis-angles of the joints that all models have."""
    shapes = " + ".join(str(list(part.shape)) for part in parts)
    rows = parts[0].shape[0] if parts[0].ndim else 0
    width = sum(part.size // max(rows, 1) for part in parts)
    is_even = all(part.ndim in (2, 3) and part.shape[0] == rows for part in parts)
    if not is_even or not 1 <= rows <= MAX_FRAMES or width < ROTATION_NUMBERS:
        expected = f"{names} [1 to {MAX_FRAMES} frames, {ROTATION_NUMBERS} or more]"
        raise InputError(path, expected, f"shape {shapes}")
    if len(parts) == 2 and parts[0].size != 3 * rows:
        raise InputError(path, f"{names} [{rows}, 3] + [{rows}, 63 or more]", f"shape {shapes}")
    columns = np.concatenate([part.reshape(rows, -1)[:, :ROTATION_NUMBERS] for part in parts], axis=1)
    joints = torch.from_numpy(columns[:, :ROTATION_NUMBERS].astype(np.float64))
    check_body_pose(joints, str(path))
    return joints


def _frame_rate(path: Path, arrays: dict[str, np.ndarray]) -> float:
    rates = [arrays[key] for key in FRAME_RATE_KEYS if key in arrays]
    if not rates or rates[0].size != 1:
        raise InputError(path, f"one number {' or '.join(FRAME_RATE_KEYS)}", "none" if not rates else "several")
    return float(rates[0].reshape(()))


def _z_up_from_file(poses: Float[Tensor, "f 66"]) -> tuple[Float[Tensor, "3 3"], tuple[str, ...]]:
    """Change of axes of the world, and what to say of it."""
    pelvis_up = float(matrix_from_axis_angle(poses[:, :3])[:, 1, 1].mean())
    if pelvis_up > Y_COSINE:
        return BODY_FROM_Y_UP, ("+y is up, unlike in AMASS",)
    if pelvis_up < -Y_COSINE:
        return BODY_FROM_Y_DOWN, ("+y is down, as in the frame of a camera",)
    return torch.eye(3, dtype=torch.float64), ()


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
        rotation = source.rotation(world)
        if name.endswith(("Arm", "Hand")):
            direction = torch.tensor(REST_ARM_DIRECTION["Left" if name.startswith("Left") else "Right"])
            rotation = rotation @ align_bone(body_bone(body, name, LIMB_BONES[name]), direction)
        rotations[name] = rotation
    return local_pose(rotations, body)
