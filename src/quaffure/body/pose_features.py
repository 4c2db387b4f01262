"""Pose features of the network, in the head's frame: gravity and the joints that hair can touch."""

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.head_frame_kernels import NEAR_HAIR, OFFSET_SCALE
from quaffure.types import Float, Tensor

HEAD = "Head"


def world_from_head(body: BodyModel, joint_rotations: Float[Tensor, "b j 3 3"]) -> Float[Tensor, "b 3 3"]:
    """Rotation of the head from the rest pose."""
    return joint_rotations[:, body.joint_names.index(HEAD)]


def pose_features(
    body: BodyModel, joint_rotations: Float[Tensor, "b j 3 3"], joint_positions: Float[Tensor, "b j 3"]
) -> Float[Tensor, "b features"]:
    """Gravity's direction, and of each joint near the hair two columns of its rotation and its offset, all in the
    head's frame: invariant to rotations of the whole body about the vertical.

    Returns:
        `FEATURE_COUNT` dimensionless numbers of about one.
    """
    head = body.joint_names.index(HEAD)
    near = [body.joint_names.index(name) for name in NEAR_HAIR]
    head_from_world = joint_rotations[:, head].mT
    down = -head_from_world[:, :, 2]
    rotations = head_from_world[:, None] @ joint_rotations[:, near]
    offsets = (joint_positions[:, near] - joint_positions[:, head, None]) @ head_from_world.mT / OFFSET_SCALE
    return torch.cat([down, rotations[..., :2].flatten(1), offsets.flatten(1)], dim=1)
