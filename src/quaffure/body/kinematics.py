"""Forward kinematics of a batch of bodies: the one place where joint rotations become joint positions."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from numba import njit

from quaffure.backend import Backend, choose_backend
from quaffure.body.body_model import BodyModel
from quaffure.geometry.rotation import write_rotation
from quaffure.types import BodyPose, BodyShape, Float, Tensor


class PosedJoints(NamedTuple):
    """Joints of posed bodies in the world, in double precision where the compiled kernel computes them.

    Attributes:
        rest: position of each joint of the shaped body in the rest pose [m].
        rotations: `world_from_joint`; the identity in the rest pose.
        positions: position of each joint [m].
    """

    rest: Float[Tensor, "b j 3"]
    rotations: Float[Tensor, "b j 3 3"]
    positions: Float[Tensor, "b j 3"]

    def rows(self, rows: slice) -> "PosedJoints":
        """Some of the bodies."""
        return PosedJoints(self.rest[rows], self.rotations[rows], self.positions[rows])


def pose_joints(body: BodyModel, body_pose: BodyPose, body_shape: BodyShape) -> PosedJoints:
    """Joints of bodies of shape beta [standard deviations] in pose theta [rad].

    Compiled, in double precision and without gradient on the CPU; in torch where a gradient is wanted or the body is
    elsewhere.
    """
    skeleton = _skeleton(body)
    differentiable = torch.is_grad_enabled() and (body_pose.requires_grad or body_shape.requires_grad)
    if differentiable or skeleton is None:
        rest = body.shaped_joints(body_shape)
        return PosedJoints(rest, *body.forward_kinematics(body_pose, rest))
    batch, count = len(body_pose), len(body.joint_parents)
    joints = PosedJoints(
        torch.empty(batch, count, 3, dtype=torch.float64),
        torch.empty(batch, count, 3, 3, dtype=torch.float64),
        torch.empty(batch, count, 3, dtype=torch.float64),
    )
    pose, shape = body_pose.detach().float().contiguous(), body_shape.detach().float().contiguous()
    _forward_kinematics(pose.numpy(), shape.numpy(), skeleton, *map(Tensor.numpy, joints))
    return joints


class _Skeleton(NamedTuple):
    rest: np.ndarray
    directions: np.ndarray
    parents: np.ndarray


@lru_cache(maxsize=4)
def _skeleton(body: BodyModel) -> _Skeleton | None:
    """For the compiled kernel; None for a body that it cannot read."""
    if choose_backend(body.rest_joints) is Backend.TORCH:
        return None
    rest, directions = body.rest_joints.double().numpy(), body.joint_shape_directions.double().numpy()
    return _Skeleton(rest, directions, np.array(body.joint_parents))


@njit(cache=True)
def _forward_kinematics(
    body_pose: np.ndarray, body_shape: np.ndarray, skeleton: _Skeleton, rest_joints: np.ndarray,
    world_rotations: np.ndarray, world_positions: np.ndarray,
) -> None:  # fmt: skip
    """Fill the fields of `PosedJoints`."""
    local = np.empty((3, 3))
    for sample in range(len(body_pose)):
        rest, rotations, positions = rest_joints[sample], world_rotations[sample], world_positions[sample]
        rest[:] = skeleton.rest
        for coefficient in range(body_shape.shape[1]):
            rest += np.float64(body_shape[sample, coefficient]) * skeleton.directions[coefficient]
        for joint in range(len(rest)):
            parent = skeleton.parents[joint]
            axis_angle = body_pose[sample, 3 * joint : 3 * joint + 3]
            if parent < 0:
                write_rotation(axis_angle, rotations[joint])
                positions[joint] = rest[joint]
                continue
            write_rotation(axis_angle, local)
            for i in range(3):
                positions[joint, i] = positions[parent, i]
                for j in range(3):
                    positions[joint, i] += rotations[parent, i, j] * (rest[joint, j] - rest[parent, j])
                    rotations[joint, i, j] = 0.0
                    for k in range(3):
                        rotations[joint, i, j] += rotations[parent, i, k] * local[k, j]
