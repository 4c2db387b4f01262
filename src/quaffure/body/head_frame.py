"""Posed bodies in the head's frame, where a drape is computed: scalp, point-sampled skin and pose features.

Only the vertices that a drape reads are posed, in compiled passes: posing all of them, and rotating strands into the
head's frame afterwards, would take longer than the network.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from numba import njit, prange

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.body.collision_skin import collision_skin
from quaffure.body.kinematics import PosedJoints
from quaffure.body.mls_body import MlsBodyConfig, mls_body, skin_points
from quaffure.body.motion import without_heading
from quaffure.body.pose_features import FEATURE_COUNT, HEAD, NEAR_HAIR, OFFSET_SCALE, pose_features
from quaffure.geometry.mls_surface import LEAF, MlsSurface
from quaffure.types import BodyPose, BodyShape, Float, Int, Tensor

_PARTS = 4  # of the skin, for threads to share one body
POSE_CODE_SIZE = 10 + 81 + FEATURE_COUNT
"""Length of the pose code: beta, theta without heading, pose features."""


class HeadFrameBody(NamedTuple):
    """A batch of posed bodies; positions are relative to the head joint and in its frame [m], if not said otherwise.

    Attributes:
        world_from_head: rotation of the head.
        head_position: of its joint in the world [m].
        pose_code: beta, theta without heading, pose features.
        scalp: posed vertices of `scalp_vertices`.
        surface: point-sampled skin that hair can touch.
        world_skin: vertices of `collision_skin`, in the world [m]; none where they are not asked for.
    """

    world_from_head: Float[Tensor, "b 3 3"]
    head_position: Float[Tensor, "b 3"]
    pose_code: Float[Tensor, "b code"]
    scalp: Float[Tensor, "b c 3"]
    surface: MlsSurface
    world_skin: Float[Tensor, "b v 3"]

    def sample(self, index: int) -> "HeadFrameBody":
        """One of the bodies."""
        one, (rotation, head, code, scalp, surface, skin) = slice(index, index + 1), self
        surface = MlsSurface(surface.points[one], surface.normals[one], surface.radius)
        return HeadFrameBody(rotation[one], head[one], code[one], scalp[one], surface, skin[one])


@lru_cache(maxsize=4)
def scalp_vertices(body: BodyModel) -> Int[Tensor, " c"]:
    """Body vertices of the scalp, ascending."""
    return body.faces[body.scalp.faces].unique()


def head_frame_body_reference(
    body: BodyModel, body_pose: BodyPose, body_shape: BodyShape, posed: PosedBody, config: MlsBodyConfig
) -> HeadFrameBody:
    """Torch twin of `head_frame_body`: any device and type, differentiable in pose and shape.

    Args:
        posed: the bodies of shape beta [standard deviations] in pose theta [rad].
    """
    joint = body.joint_names.index(HEAD)
    rotation, head = posed.joint_rotations[:, joint], posed.joint_positions[:, joint]
    features = pose_features(body, posed.joint_rotations, posed.joint_positions)
    points, normals, radius = mls_body(body, posed, config)
    surface = MlsSurface((points - head[:, None, None]) @ rotation[:, None], normals @ rotation[:, None], radius)
    scalp = (posed.vertices[:, scalp_vertices(body)] - head[:, None]) @ rotation
    code = torch.cat([body_shape, without_heading(body_pose).to(body_shape), features], dim=1)
    skin = posed.vertices[:, collision_skin(body).vertices]
    return HeadFrameBody(rotation, head, code, scalp, surface, skin)


def head_frame_body(
    body: BodyModel,
    body_pose: BodyPose,
    body_shape: BodyShape,
    joints: PosedJoints,
    config: MlsBodyConfig,
    collides: bool = True,
) -> HeadFrameBody:
    """Bodies of shape beta [standard deviations] in pose theta [rad]; float32, on the CPU.

    Args:
        joints: of these bodies.
        collides: pose the collision skin too.
    """
    skin, batch = _skin_to_pose(body, config.leaves, collides), len(body_pose)
    rotation, head, code = torch.empty(batch, 3, 3), torch.empty(batch, 3), torch.empty(batch, POSE_CODE_SIZE)
    positions, normals = torch.empty(batch, len(skin.rest), 3), torch.empty(batch, len(skin.normals), 3)
    pose, shape = body_pose.detach().float().contiguous(), body_shape.detach().float().contiguous()
    rest, rotations, centres = joints.rest.double(), joints.rotations.double(), joints.positions.double()
    world = _WorldJoints(
        pose.numpy(), shape.numpy(), rest.numpy(), rotations.numpy(), centres.numpy(), _near_hair(body)
    )
    frame = _HeadFrame(rotation.numpy(), head.numpy(), code.numpy())
    _pose_bodies(world, skin, frame, positions.numpy(), normals.numpy())
    count, rest_count = len(skin.normals), len(scalp_vertices(body))
    points = positions[:, :count].unflatten(1, (-1, LEAF))
    surface = MlsSurface(points, normals.unflatten(1, (-1, LEAF)), config.kernel_radius)
    scalp, far = positions[:, count : count + rest_count].contiguous(), positions[:, count + rest_count :]
    return HeadFrameBody(rotation, head, code, scalp, surface, far @ rotation.mT + head[:, None])


class _WorldJoints(NamedTuple):
    """Pose, shape and `PosedJoints`, and the joints of the pose features, the head first."""

    body_pose: np.ndarray
    body_shape: np.ndarray
    rest: np.ndarray
    rotations: np.ndarray
    positions: np.ndarray
    near: np.ndarray


class _HeadFrame(NamedTuple):
    """The first fields of `HeadFrameBody`."""

    world_from_head: np.ndarray
    head_position: np.ndarray
    pose_code: np.ndarray


class _Skin(NamedTuple):
    """Vertices to pose, first those with normals: [vertex, axis], directions [vertex, axis, coefficient]."""

    rest: np.ndarray
    directions: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    normals: np.ndarray


@lru_cache(maxsize=4)
def _near_hair(body: BodyModel) -> Int[np.ndarray, " j"]:
    return np.array([body.joint_names.index(name) for name in (HEAD, *NEAR_HAIR)])


@lru_cache(maxsize=8)
def _skin_to_pose(body: BodyModel, leaves: int, collides: bool) -> _Skin:
    """Sampled points, then the scalp, then the collision skin."""
    points, normals, _ = skin_points(body, leaves)
    vertices = torch.cat([points, scalp_vertices(body), collision_skin(body).vertices[: None if collides else 0]])
    return _Skin(
        body.rest_vertices[vertices].numpy(),
        body.shape_directions[:, vertices].permute(1, 2, 0).contiguous().numpy(),
        body.skin_joints[vertices].numpy(),
        body.skin_weights[vertices].contiguous().numpy(),
        normals.contiguous().numpy(),
    )


@njit(cache=True)
def _pose_bodies(
    joints: _WorldJoints, skin: _Skin, frames: _HeadFrame, positions: np.ndarray, normals: np.ndarray
) -> None:
    """Fill frames, vertices in the head's frame, and the normals of those that have one."""
    transforms = np.empty((*joints.rest.shape[:2], 12), np.float32)  # 3 x 4, from rest vertices to the head's frame
    for sample in range(len(joints.body_pose)):
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
    _pose_skin(joints.body_shape, skin, transforms, positions, normals)


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
    """`pose_features`; the head is the first of `near` and has none of its own."""
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
    body_shape: np.ndarray, skin: _Skin, transforms: np.ndarray, positions: np.ndarray, normals: np.ndarray
) -> None:
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
