"""Posed bodies in the head's frame, where a drape is computed: scalp, point-sampled skin and pose features.

Only the vertices that a drape reads are posed, in compiled passes: posing all of them, and rotating strands into the
head's frame afterwards, would take longer than the network. Shapes cannot be checked at run time inside compiled code,
hence `no_type_check`.
"""

import math
from functools import lru_cache
from typing import NamedTuple, no_type_check

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
    """A batch of posed bodies; positions are relative to the head joint and in the head's frame [m].

    Attributes:
        world_from_head: rotation of the head.
        head: position of its joint in the world [m].
        pose_code: beta, theta without heading, pose features.
        scalp: posed vertices of `scalp_vertices`.
        surface: point-sampled skin that hair can touch.
    """

    world_from_head: Float[Tensor, "b 3 3"]
    head: Float[Tensor, "b 3"]
    pose_code: Float[Tensor, "b code"]
    scalp: Float[Tensor, "b c 3"]
    surface: MlsSurface

    def sample(self, index: int) -> "HeadFrameBody":
        """One of the bodies."""
        one = slice(index, index + 1)
        rotation, head, code, scalp, (points, normals, radius) = self
        surface = MlsSurface(points[one], normals[one], radius)
        return HeadFrameBody(rotation[one], head[one], code[one], scalp[one], surface)


class HeadFrameJoints(NamedTuple):
    """Joints in the head's frame, for the compiled passes.

    Attributes:
        body_shape: beta [standard deviations].
        transforms: 3 x 4 matrices from rest vertices to the head's frame, of each joint.
        world_from_head, head, pose_code: see `HeadFrameBody`.
    """

    body_shape: Float[Tensor, "b 10"]
    transforms: Float[np.ndarray, "b j 12"]
    world_from_head: Float[Tensor, "b 3 3"]
    head: Float[Tensor, "b 3"]
    pose_code: Float[Tensor, "b code"]


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
    return HeadFrameBody(rotation, head, code, scalp, surface)


def head_frame_joints(
    body: BodyModel, body_pose: BodyPose, body_shape: BodyShape, posed: PosedJoints
) -> HeadFrameJoints:
    """Joints of bodies of shape beta [standard deviations] in pose theta [rad]; float32, on the CPU.

    Args:
        posed: these joints in the world.
    """
    batch, count = posed.rest.shape[:2]
    transforms = np.empty((batch, count, 3, 4), np.float32)
    rotation, head, code = torch.empty(batch, 3, 3), torch.empty(batch, 3), torch.empty(batch, POSE_CODE_SIZE)
    pose, shape = body_pose.detach().float().contiguous(), body_shape.detach().float().contiguous()
    world = _WorldJoints(pose.numpy(), shape.numpy(), *(field.double().numpy() for field in posed), _near_hair(body))
    _enter_head_frame(world, transforms, rotation.numpy(), head.numpy(), code.numpy())
    return HeadFrameJoints(shape, transforms.reshape(batch, count, 12), rotation, head, code)


def head_frame_body(body: BodyModel, joints: HeadFrameJoints, config: MlsBodyConfig) -> HeadFrameBody:
    """The bodies of `joints`; float32, on the CPU."""
    skin = _sampled_skin(body, config.leaves)
    positions, normals = _posed_vertices(skin, joints)
    points = positions[:, : len(skin.normals)].unflatten(1, (-1, LEAF))
    surface = MlsSurface(points, normals.unflatten(1, (-1, LEAF)), config.kernel_radius)
    scalp = positions[:, len(skin.normals) :].contiguous()
    return HeadFrameBody(joints.world_from_head, joints.head, joints.pose_code, scalp, surface)


def posed_skin(body: BodyModel, joints: HeadFrameJoints) -> Float[Tensor, "b v 3"]:
    """The vertices of `collision_skin(body)` [m, world], as in `BodyModel.pose`; float32, on the CPU."""
    positions, _ = _posed_vertices(_collision_skin(body), joints)
    return positions @ joints.world_from_head.mT + joints.head[:, None]


def _posed_vertices(
    skin: "_Skin", joints: HeadFrameJoints
) -> tuple[Float[Tensor, "b v 3"], Float[Tensor, "b p 3"]]:
    """Vertices, and the normals of those that have one, in the head's frame."""
    batch = len(joints.head)
    positions, normals = torch.empty(batch, len(skin.rest), 3), torch.empty(batch, len(skin.normals), 3)
    _pose_skin(joints.body_shape.numpy(), skin, joints.transforms, positions.numpy(), normals.numpy())
    return positions, normals


class _WorldJoints(NamedTuple):
    """Pose, shape and `PosedJoints`, and the joints of the pose features, the head first."""

    body_pose: np.ndarray
    body_shape: np.ndarray
    rest: np.ndarray
    rotations: np.ndarray
    positions: np.ndarray
    near: np.ndarray


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


@lru_cache(maxsize=4)
def _sampled_skin(body: BodyModel, leaves: int) -> _Skin:
    points, normals, _ = skin_points(body, leaves)
    return _skin_of(body, torch.cat([points, scalp_vertices(body)]), normals)


@lru_cache(maxsize=4)
def _collision_skin(body: BodyModel) -> _Skin:
    return _skin_of(body, collision_skin(body).vertices, torch.empty(0, 3))


def _skin_of(body: BodyModel, vertices: Int[Tensor, " v"], normals: Float[Tensor, "p 3"]) -> _Skin:
    return _Skin(
        body.rest_vertices[vertices].numpy(),
        body.shape_directions[:, vertices].permute(1, 2, 0).contiguous().numpy(),
        body.skin_joints[vertices].numpy(),
        body.skin_weights[vertices].contiguous().numpy(),
        normals.contiguous().numpy(),
    )


@no_type_check
@njit(cache=True)
def _enter_head_frame(
    joints: _WorldJoints, transforms: np.ndarray, world_from_head: np.ndarray, head: np.ndarray, code: np.ndarray
) -> None:
    """Fill the fields of `HeadFrameJoints`."""
    for sample in range(len(joints.body_pose)):
        rest, rotations, positions = joints.rest[sample], joints.rotations[sample], joints.positions[sample]
        frame, origin = rotations[joints.near[0]], positions[joints.near[0]]
        world_from_head[sample] = frame
        head[sample] = origin
        _write_transforms(rest, rotations, positions, frame, origin, transforms[sample])
        _write_features(positions, joints.near, frame, origin, transforms[sample], code[sample, -FEATURE_COUNT:])
        code[sample, :10] = joints.body_shape[sample]
        code[sample, 10:91] = joints.body_pose[sample]
        _remove_heading(joints.body_pose[sample, :3], code[sample, 10:13])


@no_type_check
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


@no_type_check
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


@no_type_check
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


@no_type_check
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
