"""Posed bodies as a drape needs them, in compiled passes.

A network asks for the scalp, for a thousand points of the skin that hair can touch and for how head, neck, shoulders
and arms stand, all of it seen from the head; what pushes hair out of the skin asks for that skin in the world. Posing
every vertex, and turning strands into the head's frame afterwards, would take longer than the network.
Shapes cannot be checked at run time inside compiled code, hence `no_type_check`.
"""

import math
from functools import lru_cache
from typing import NamedTuple, no_type_check

import numpy as np
import torch
from numba import njit, prange

from quaffure.body.body_model import BodyModel
from quaffure.body.collision_skin import collision_skin
from quaffure.body.mls_body import KERNEL_RADIUS, mls_body, skin_points
from quaffure.body.motion import without_heading
from quaffure.body.pose_features import FEATURE_COUNT, HEAD, NEAR_HAIR, OFFSET_SCALE, pose_features
from quaffure.geometry.mls_surface import LEAF, MlsSurface
from quaffure.geometry.rotation import write_rotation
from quaffure.types import BodyPose, BodyShape, Float, Int, Tensor

_PARTS = 4  # of the skin, for threads to share one body
POSE_CODE_SIZE = 10 + 81 + FEATURE_COUNT
"""Length of what the network is told of shape and pose: beta, theta without heading, pose features."""


class HeadFrameBody(NamedTuple):
    """A batch of posed bodies; positions are relative to the head joint and in the head's frame [m].

    Attributes:
        world_from_head: rotation of the head.
        head: where its joint is in the world [m].
        pose_code: beta, theta without heading, pose features.
        scalp: posed vertices of `scalp_vertices`.
        surface: the skin that hair can touch, softened.
    """

    world_from_head: Float[Tensor, "b 3 3"]
    head: Float[Tensor, "b 3"]
    pose_code: Float[Tensor, "b code"]
    scalp: Float[Tensor, "b c 3"]
    surface: MlsSurface

    def sample(self, index: int) -> "HeadFrameBody":
        """One of the bodies."""
        one = slice(index, index + 1)
        surface = MlsSurface(self.surface.points[one], self.surface.normals[one], self.surface.radius)
        return HeadFrameBody(self.world_from_head[one], self.head[one], self.pose_code[one], self.scalp[one], surface)


@lru_cache(maxsize=4)
def scalp_vertices(body: BodyModel) -> Int[Tensor, " c"]:
    """Body vertices of the scalp, ascending."""
    return body.faces[body.scalp.faces].unique()


def head_frame_body_reference(body: BodyModel, body_pose: BodyPose, body_shape: BodyShape) -> HeadFrameBody:
    """Torch twin of `head_frame_body`."""
    posed = body.pose(body_pose, body_shape)
    joint = body.joint_names.index(HEAD)
    rotation, head = posed.joint_rotations[:, joint], posed.joint_positions[:, joint]
    features = pose_features(body, posed.joint_rotations, posed.joint_positions)
    surface = mls_body(body, posed)
    seen = MlsSurface(
        (surface.points - head[:, None, None]) @ rotation[:, None],
        surface.normals @ rotation[:, None],
        surface.radius,
    )
    scalp = (posed.vertices[:, scalp_vertices(body)] - head[:, None]) @ rotation
    code = torch.cat([body_shape, without_heading(body_pose).to(body_shape), features], dim=1)
    return HeadFrameBody(rotation, head, code, scalp, seen)


def head_frame_body(body: BodyModel, body_pose: BodyPose, body_shape: BodyShape) -> HeadFrameBody:
    """Bodies of shape beta [standard deviations] in pose theta [rad], seen from their heads."""
    if body_pose.device.type != "cpu" or body.rest_vertices.dtype != torch.float32:
        return head_frame_body_reference(body, body_pose, body_shape)
    joints, skin = _posed_joints(body, body_pose, body_shape), _skin(body)
    positions, normals = _posed_vertices(skin, joints)
    points = positions[:, : len(skin.normals)].unflatten(1, (-1, LEAF))
    surface = MlsSurface(points, normals.unflatten(1, (-1, LEAF)), KERNEL_RADIUS)
    scalp = positions[:, len(skin.normals) :].contiguous()
    return HeadFrameBody(joints.world_from_head, joints.head, joints.pose_code, scalp, surface)


def posed_skin(
    body: BodyModel, body_pose: BodyPose, body_shape: BodyShape
) -> tuple[Float[Tensor, "b v 3"], Float[Tensor, "b 3"]]:
    """The vertices of `collision_skin(body)` and the head joint [m, world], as in `BodyModel.pose`; on the CPU."""
    joints = _posed_joints(body, body_pose, body_shape)
    positions, _ = _posed_vertices(_whole_skin(body), joints)
    return positions @ joints.world_from_head.mT + joints.head[:, None], joints.head


class _PosedJoints(NamedTuple):
    """`HeadFrameBody`'s fields, beta, and for each joint what takes a rest vertex to where it is seen from the head."""

    shape: Float[Tensor, "b 10"]
    transforms: Float[np.ndarray, "b j 12"]
    world_from_head: Float[Tensor, "b 3 3"]
    head: Float[Tensor, "b 3"]
    pose_code: Float[Tensor, "b code"]


def _posed_joints(body: BodyModel, body_pose: BodyPose, body_shape: BodyShape) -> _PosedJoints:
    batch, count = len(body_pose), len(body.joint_parents)
    transforms = np.empty((batch, count, 3, 4), np.float32)
    rotation, head, code = torch.empty(batch, 3, 3), torch.empty(batch, 3), torch.empty(batch, POSE_CODE_SIZE)
    pose, shape = body_pose.detach().float().contiguous(), body_shape.detach().float().contiguous()
    _pose_joints(pose.numpy(), shape.numpy(), _skeleton(body), transforms, rotation.numpy(), head.numpy(), code.numpy())
    return _PosedJoints(shape, transforms.reshape(batch, count, 12), rotation, head, code)


def _posed_vertices(skin: "_Skin", joints: _PosedJoints) -> tuple[Float[Tensor, "b v 3"], Float[Tensor, "b p 3"]]:
    """Vertices, and the normals of those that have one, seen from the head."""
    batch = len(joints.head)
    positions, normals = torch.empty(batch, len(skin.rest), 3), torch.empty(batch, len(skin.normals), 3)
    _pose_skin(joints.shape.numpy(), skin, joints.transforms, positions.numpy(), normals.numpy())
    return positions, normals


class _Skeleton(NamedTuple):
    rest: np.ndarray
    directions: np.ndarray
    parents: np.ndarray
    near: np.ndarray
    head: int


class _Skin(NamedTuple):
    """Vertices to pose, first those with normals: [vertex, axis], directions [vertex, axis, coefficient]."""

    rest: np.ndarray
    directions: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    normals: np.ndarray


@lru_cache(maxsize=4)
def _skeleton(body: BodyModel) -> _Skeleton:
    near = [body.joint_names.index(name) for name in NEAR_HAIR]
    return _Skeleton(
        body.rest_joints.double().numpy(),
        body.joint_shape_directions.double().numpy(),
        np.array(body.joint_parents),
        np.array(near),
        body.joint_names.index(HEAD),
    )


@lru_cache(maxsize=4)
def _skin(body: BodyModel) -> _Skin:
    points, normals, _ = skin_points(body)
    return _skin_of(body, torch.cat([points, scalp_vertices(body)]), normals)


@lru_cache(maxsize=4)
def _whole_skin(body: BodyModel) -> _Skin:
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
def _pose_joints(
    body_pose: np.ndarray,
    body_shape: np.ndarray,
    skeleton: _Skeleton,
    transforms: np.ndarray,
    world_from_head: np.ndarray,
    head: np.ndarray,
    code: np.ndarray,
) -> None:
    """Forward kinematics, in double precision; `transforms` take a rest vertex to where it is seen from the head."""
    count = len(skeleton.rest)
    rest, positions, rotations = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3, 3))
    local = np.empty((3, 3))
    for sample in range(len(body_pose)):
        rest[:] = skeleton.rest
        for coefficient in range(body_shape.shape[1]):
            rest += np.float64(body_shape[sample, coefficient]) * skeleton.directions[coefficient]
        for joint in range(count):
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
        world_from_head[sample] = rotations[skeleton.head]
        head[sample] = positions[skeleton.head]
        _see(rest, rotations, positions, skeleton, transforms[sample], code[sample, -FEATURE_COUNT:])
        code[sample, :10] = body_shape[sample]
        code[sample, 10:91] = body_pose[sample]
        _take_heading_off(body_pose[sample, :3], code[sample, 10:13])


@no_type_check
@njit(cache=True)
def _take_heading_off(hips: np.ndarray, answer: np.ndarray) -> None:
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
    answer[0], answer[1], answer[2] = ratio * x, ratio * y, 0.0


@no_type_check
@njit(cache=True)
def _see(
    rest: np.ndarray,
    rotations: np.ndarray,
    positions: np.ndarray,
    skeleton: _Skeleton,
    transforms: np.ndarray,
    features: np.ndarray,
) -> None:
    """Transforms into the head's frame, and `pose_features`."""
    eye = rotations[skeleton.head]
    origin = positions[skeleton.head]
    for joint in range(len(rest)):
        for i in range(3):
            for j in range(3):
                transforms[joint, i, j] = (
                    eye[0, i] * rotations[joint, 0, j]
                    + eye[1, i] * rotations[joint, 1, j]
                    + eye[2, i] * rotations[joint, 2, j]
                )
            place = 0.0
            for k in range(3):
                offset = positions[joint, k] - origin[k]
                for j in range(3):
                    offset -= rotations[joint, k, j] * rest[joint, j]
                place += eye[k, i] * offset
            transforms[joint, i, 3] = place
    near = skeleton.near
    for i in range(3):
        features[i] = -eye[2, i]
    for index in range(len(near)):
        joint = near[index]
        for i in range(3):
            features[3 + 6 * index + 2 * i] = transforms[joint, i, 0]
            features[3 + 6 * index + 2 * i + 1] = transforms[joint, i, 1]
            place = 0.0
            for k in range(3):
                place += eye[k, i] * (positions[joint, k] - origin[k])
            features[3 + 6 * len(near) + 3 * index + i] = place / OFFSET_SCALE


@no_type_check
@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _pose_skin(
    body_shape: np.ndarray, skin: _Skin, transforms: np.ndarray, positions: np.ndarray, normals: np.ndarray
) -> None:
    batch, vertices = positions.shape[:2]
    # Rows so long that threads do not write into one line of the cache.
    scratch = np.empty((batch * _PARTS, 32), np.float32)
    for item in prange(batch * _PARTS):
        sample, part, place, blend = item // _PARTS, item % _PARTS, scratch[item, :3], scratch[item, 3:15]
        for vertex in range(part * vertices // _PARTS, (part + 1) * vertices // _PARTS):
            for axis in range(3):
                place[axis] = skin.rest[vertex, axis]
                for coefficient in range(body_shape.shape[1]):
                    place[axis] += body_shape[sample, coefficient] * skin.directions[vertex, axis, coefficient]
            blend[:] = np.float32(0.0)
            for slot in range(skin.joints.shape[1]):
                weight, joint = skin.weights[vertex, slot], skin.joints[vertex, slot]
                if weight > np.float32(0.0):
                    for k in range(12):
                        blend[k] += weight * transforms[sample, joint, k]
            for i in range(3):
                turned = blend[4 * i] * place[0] + blend[4 * i + 1] * place[1] + blend[4 * i + 2] * place[2]
                positions[sample, vertex, i] = turned + blend[4 * i + 3]
            if vertex < len(skin.normals):
                nx, ny, nz = skin.normals[vertex, 0], skin.normals[vertex, 1], skin.normals[vertex, 2]
                square = np.float32(1e-24)
                for i in range(3):
                    place[i] = blend[4 * i] * nx + blend[4 * i + 1] * ny + blend[4 * i + 2] * nz
                    square += place[i] * place[i]
                for i in range(3):
                    normals[sample, vertex, i] = place[i] / np.sqrt(square)
