"""Compiled forward kinematics, in double precision; `quaffure.body.kinematics` calls it with tensors."""

from typing import NamedTuple

import numpy as np
from numba import njit

from quaffure.geometry.rotation_kernel import write_rotation


class Skeleton(NamedTuple):
    """Joints at rest [j,3] and how each shape coefficient moves them [c,j,3], in metres, and their parents [j]."""

    rest: np.ndarray
    directions: np.ndarray
    parents: np.ndarray


@njit(cache=True)
def forward_kinematics(
    body_pose: np.ndarray, body_shape: np.ndarray, skeleton: Skeleton
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The fields of `quaffure.body.kinematics.PosedJoints` of bodies of shape beta [b, 10] in pose theta [b, 81],
    float32."""
    batch, count = len(body_pose), len(skeleton.parents)
    rest_joints, local = np.empty((batch, count, 3)), np.empty((3, 3))
    world_rotations, world_positions = np.empty((batch, count, 3, 3)), np.empty((batch, count, 3))
    for sample in range(batch):
        rest, rotations, positions = rest_joints[sample], world_rotations[sample], world_positions[sample]
        for joint in range(len(rest)):
            for axis in range(3):
                rest[joint, axis] = skeleton.rest[joint, axis]
                for coefficient in range(body_shape.shape[1]):
                    change = skeleton.directions[coefficient, joint, axis]
                    rest[joint, axis] += np.float64(body_shape[sample, coefficient]) * change
        for joint in range(len(rest)):
            parent = skeleton.parents[joint]
            axis_angle = body_pose[sample, 3 * joint : 3 * joint + 3]
            if parent < 0:
                write_rotation(axis_angle, rotations[joint])
                for axis in range(3):
                    positions[joint, axis] = rest[joint, axis]
                continue
            write_rotation(axis_angle, local)
            for i in range(3):
                positions[joint, i] = positions[parent, i]
                for j in range(3):
                    positions[joint, i] += rotations[parent, i, j] * (rest[joint, j] - rest[parent, j])
                    rotations[joint, i, j] = 0.0
                    for k in range(3):
                        rotations[joint, i, j] += rotations[parent, i, k] * local[k, j]
    return rest_joints, world_rotations, world_positions
