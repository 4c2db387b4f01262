"""Compiled parts of `quaffure.body.head_frame`: bodies posed in the head's frame."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

NEAR_HAIR = (
    *("Neck1", "Neck", "Spine1", "Spine"),
    *(f"{side}{part}" for part in ("Shoulder", "Arm", "ForeArm", "Hand") for side in ("Left", "Right")),
)
"""Joints whose frames relative to the head are features; hair never reaches the legs."""
FEATURE_COUNT = 3 + len(NEAR_HAIR) * 9
"""Length of the pose features."""
POSE_CODE_SIZE = 10 + 81 + FEATURE_COUNT
"""Length of the pose code: beta, theta without heading, pose features."""
OFFSET_SCALE = 0.25
"""Brings the offsets of joints near the head to about one [m]."""
_PARTS = 4  # of the skin, for threads to share one body


class WorldJoints(NamedTuple):
    """Pose, shape and `quaffure.body.kinematics.PosedJoints`, and the joints of the pose features, the head first."""

    body_pose: np.ndarray
    body_shape: np.ndarray
    rest: np.ndarray
    rotations: np.ndarray
    positions: np.ndarray
    near: np.ndarray


class HeadFrame(NamedTuple):
    """The first fields of `quaffure.body.head_frame.HeadFrameBody`."""

    world_from_head: np.ndarray
    head_position: np.ndarray
    pose_code: np.ndarray


class Skin(NamedTuple):
    """Vertices to pose, first those with normals: [vertex, axis], directions [vertex, axis, coefficient]."""

    rest: np.ndarray
    directions: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    normals: np.ndarray


NO_OFFSETS = np.empty((0, 0, 3), np.float32)


@njit(cache=True)
def pose_bodies(joints: WorldJoints, skin: Skin, offsets: np.ndarray) -> tuple[HeadFrame, np.ndarray, np.ndarray]:
    """Frames, vertices in the head's frame [b, v, 3] [m], and the normals of those that have one [b, p, 3].

    Args:
        offsets: added to the vertices at rest [b, v, 3] [m], or `NO_OFFSETS`.
    """
    batch, vertices, sampled = len(joints.body_pose), len(skin.rest), len(skin.normals)
    frames = HeadFrame(
        np.empty((batch, 3, 3), np.float32),
        np.empty((batch, 3), np.float32),
        np.empty((batch, POSE_CODE_SIZE), np.float32),
    )
    positions, normals = np.empty((batch, vertices, 3), np.float32), np.empty((batch, sampled, 3), np.float32)
    transforms = np.empty((*joints.rest.shape[:2], 12), np.float32)  # 3 x 4, from rest vertices to the head's frame
    for sample in range(batch):
        rest, rotations, centres = joints.rest[sample], joints.rotations[sample], joints.positions[sample]
        frame, origin, code = rotations[joints.near[0]], centres[joints.near[0]], frames.pose_code[sample]
        frames.world_from_head[sample] = frame
        frames.head_position[sample] = origin
        own_transforms = transforms[sample].reshape((len(rest), 3, 4))
        _write_transforms(rest, rotations, centres, frame, origin, own_transforms)
        _write_features(centres, joints.near, frame, origin, own_transforms, code[-FEATURE_COUNT:])
        code[:10] = joints.body_shape[sample]
        code[10:91] = joints.body_pose[sample]
        _remove_heading(joints.body_pose[sample, :3], code[10:13])
    _pose_skin(joints.body_shape, skin, offsets, transforms, positions, normals)
    return frames, positions, normals


@njit(cache=True)
def _remove_heading(hips: np.ndarray, swing: np.ndarray) -> None:
    """`without_heading` of the Hips: the swing of their quaternion's swing-twist split about z."""
    x, y, z = np.float64(hips[0]), np.float64(hips[1]), np.float64(hips[2])
    angle = math.sqrt(x * x + y * y + z * z)
    scale = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    w, x, y, z = math.cos(0.5 * angle), scale * x, scale * y, scale * z
    twist = math.sqrt(w * w + z * z)
    c, s = (w / twist, z / twist) if twist > 1e-12 else (1.0, 0.0)
    x, y = c * x + s * y, c * y - s * x
    sine = math.sqrt(x * x + y * y)
    ratio = 2.0 * math.atan2(sine, twist) / sine if sine > 1e-12 else 2.0
    swing[0], swing[1], swing[2] = ratio * x, ratio * y, 0.0


@njit(cache=True)
def _write_transforms(
    rest: np.ndarray, rotations: np.ndarray, positions: np.ndarray, frame: np.ndarray, origin: np.ndarray,
    transforms: np.ndarray,
) -> None:  # fmt: skip
    """Transforms of rest vertices into the head's frame."""
    for joint in range(len(rest)):
        for i in range(3):
            for j in range(3):
                transforms[joint, i, j] = (
                    frame[0, i] * rotations[joint, 0, j]
                    + frame[1, i] * rotations[joint, 1, j]
                    + frame[2, i] * rotations[joint, 2, j]
                )
            coordinate = 0.0
            for k in range(3):
                offset = positions[joint, k] - origin[k]
                for j in range(3):
                    offset -= rotations[joint, k, j] * rest[joint, j]
                coordinate += frame[k, i] * offset
            transforms[joint, i, 3] = coordinate


@njit(cache=True)
def _write_features(
    positions: np.ndarray, near: np.ndarray, frame: np.ndarray, origin: np.ndarray, transforms: np.ndarray,
    features: np.ndarray,
) -> None:  # fmt: skip
    """`quaffure.body.pose_features`; the head is the first of `near` and has none of its own."""
    for i in range(3):
        features[i] = -frame[2, i]
    for index in range(len(near) - 1):
        joint = near[index + 1]
        for i in range(3):
            features[3 + 6 * index + 2 * i] = transforms[joint, i, 0]
            features[3 + 6 * index + 2 * i + 1] = transforms[joint, i, 1]
            coordinate = 0.0
            for k in range(3):
                coordinate += frame[k, i] * (positions[joint, k] - origin[k])
            features[3 + 6 * (len(near) - 1) + 3 * index + i] = coordinate / OFFSET_SCALE


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _pose_skin(
    body_shape: np.ndarray, skin: Skin, offsets: np.ndarray, transforms: np.ndarray, positions: np.ndarray,
    normals: np.ndarray,
) -> None:  # fmt: skip
    batch, vertices = positions.shape[:2]
    # Rows so long that threads do not write into one line of the cache.
    scratch = np.empty((batch * _PARTS, 32), np.float32)
    for item in prange(batch * _PARTS):
        sample, part, point, blend = item // _PARTS, item % _PARTS, scratch[item, :3], scratch[item, 3:15]
        for vertex in range(part * vertices // _PARTS, (part + 1) * vertices // _PARTS):
            for axis in range(3):
                point[axis] = skin.rest[vertex, axis]
                for coefficient in range(body_shape.shape[1]):
                    point[axis] += body_shape[sample, coefficient] * skin.directions[vertex, axis, coefficient]
                if len(offsets) > 0:
                    point[axis] += offsets[sample, vertex, axis]
            blend[:] = np.float32(0.0)
            for slot in range(skin.joints.shape[1]):
                weight, joint = skin.weights[vertex, slot], skin.joints[vertex, slot]
                if weight > np.float32(0.0):
                    for k in range(12):
                        blend[k] += weight * transforms[sample, joint, k]
            for i in range(3):
                rotated = blend[4 * i] * point[0] + blend[4 * i + 1] * point[1] + blend[4 * i + 2] * point[2]
                positions[sample, vertex, i] = rotated + blend[4 * i + 3]
            if vertex < len(skin.normals):
                nx, ny, nz = skin.normals[vertex, 0], skin.normals[vertex, 1], skin.normals[vertex, 2]
                square = np.float32(1e-24)
                for i in range(3):
                    point[i] = blend[4 * i] * nx + blend[4 * i + 1] * ny + blend[4 * i + 2] * nz
                    square += point[i] * point[i]
                for i in range(3):
                    normals[sample, vertex, i] = point[i] / np.sqrt(square)
