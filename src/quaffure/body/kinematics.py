"""Forward kinematics of a batch of bodies: the one place where joint rotations become joint positions."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from quaffure.backend import Backend, choose_backend
from quaffure.body.body_model import BodyModel
from quaffure.body.kinematics_kernel import Skeleton, forward_kinematics
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
    skeleton = skeleton_of(body)
    differentiable = torch.is_grad_enabled() and (body_pose.requires_grad or body_shape.requires_grad)
    if differentiable or skeleton is None:
        rest = body.shaped_joints(body_shape)
        return PosedJoints(rest, *body.forward_kinematics(body_pose, rest))
    pose, shape = body_pose.detach().float().contiguous(), body_shape.detach().float().contiguous()
    return PosedJoints(*map(torch.from_numpy, forward_kinematics(pose.numpy(), shape.numpy(), skeleton)))


@lru_cache(maxsize=4)
def skeleton_of(body: BodyModel) -> Skeleton | None:
    """For the compiled kernel; None for a body that it cannot read."""
    if choose_backend(body.rest_joints) is Backend.TORCH:
        return None
    rest, directions = body.rest_joints.double().numpy(), body.joint_shape_directions.double().numpy()
    return Skeleton(rest, directions, np.array(body.joint_parents))
