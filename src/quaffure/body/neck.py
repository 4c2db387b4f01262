"""The neck as one joint: a single rotation of the head that three joints share."""

from quaffure.body.body_model import JOINT_COUNT, BodyModel
from quaffure.body.pose_features import HEAD
from quaffure.geometry.rotation import axis_angle_from_matrix
from quaffure.types import BodyPose, Float, Tensor

NECK_SHARES = {"Neck": 0.28, "Neck1": 0.34, HEAD: 0.38}
"""Share of each joint in a rotation of the head, from the trunk up; they sum to 1."""


def neck_pose(body: BodyModel, rotation: Float[Tensor, "b 3"]) -> BodyPose:
    """The rest pose but for the neck [rad].

    Args:
        rotation: vector of the head in rest axes: x bends forward, y leans to the left, z turns to the left [rad].
    """
    pose = rotation.new_zeros(len(rotation), JOINT_COUNT, 3)
    for joint, share in NECK_SHARES.items():
        pose[:, body.joint_names.index(joint)] = share * rotation
    return pose.flatten(1)


def head_rotation(body: BodyModel, joint_rotations: Float[Tensor, "b j 3 3"]) -> Float[Tensor, "b 3"]:
    """Rotation vector of the head relative to the trunk [rad], at most half a turn; undoes `neck_pose`.

    Args:
        joint_rotations: `world_from_joint`.
    """
    first, head = (body.joint_names.index(name) for name in (next(iter(NECK_SHARES)), HEAD))
    world_from_trunk = joint_rotations[:, body.joint_parents[first]]
    return axis_angle_from_matrix(world_from_trunk.mT @ joint_rotations[:, head])
