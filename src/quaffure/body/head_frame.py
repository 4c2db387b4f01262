"""Posed bodies in the head's frame, where a drape is computed: scalp, point-sampled skin and pose features.

Only the vertices that a drape reads are posed, in compiled passes: posing all of them, and rotating strands into the
head's frame afterwards, would take longer than the network.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel, PosedBody, check_offsets
from quaffure.body.collision_skin import collision_skin
from quaffure.body.head_frame_kernels import NO_OFFSETS, Skin, WorldJoints, pose_bodies
from quaffure.body.kinematics import PosedJoints
from quaffure.body.mls_body import MlsBodyConfig, mls_body, skin_points
from quaffure.body.motion import without_heading
from quaffure.body.pose_features import HEAD, NEAR_HAIR, pose_features
from quaffure.geometry.mls_kernels import LEAF
from quaffure.geometry.mls_surface import MlsSurface
from quaffure.types import BodyPose, BodyShape, Float, Int, Tensor


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
    offsets: Float[Tensor, "b v 3"] | None = None,
) -> HeadFrameBody:
    """Bodies of shape beta [standard deviations] in pose theta [rad]; float32, on the CPU.

    Args:
        joints: of these bodies.
        collides: pose the collision skin too.
        offsets: added to the vertices of the body at rest [m].

    Raises:
        InputError: offsets of another number of bodies or of vertices.
    """
    skin = skin_to_pose(body, config.leaves, collides)
    pose, shape = body_pose.detach().float().contiguous(), body_shape.detach().float().contiguous()
    rest, rotations, centres = joints.rest.double(), joints.rotations.double(), joints.positions.double()
    world = WorldJoints(pose.numpy(), shape.numpy(), rest.numpy(), rotations.numpy(), centres.numpy(), near_hair(body))
    moved = NO_OFFSETS
    if offsets is not None:
        check_offsets(offsets, body, len(body_pose))
        moved = offsets[:, posed_vertices(body, config.leaves, collides)].detach().float().contiguous().numpy()
    frame, *vertices = pose_bodies(world, skin, moved)
    (rotation, head, code), (positions, normals) = map(torch.from_numpy, frame), map(torch.from_numpy, vertices)
    count, rest_count = len(skin.normals), len(scalp_vertices(body))
    points = positions[:, :count].unflatten(1, (-1, LEAF))
    surface = MlsSurface(points, normals.unflatten(1, (-1, LEAF)), config.kernel_radius)
    scalp, far = positions[:, count : count + rest_count].contiguous(), positions[:, count + rest_count :]
    return HeadFrameBody(rotation, head, code, scalp, surface, far @ rotation.mT + head[:, None])


@lru_cache(maxsize=4)
def near_hair(body: BodyModel) -> Int[np.ndarray, " j"]:
    return np.array([body.joint_names.index(name) for name in (HEAD, *NEAR_HAIR)])


def posed_vertices(body: BodyModel, leaves: int, collides: bool) -> Int[Tensor, " k"]:
    """Body vertices of `skin_to_pose`: sampled points, then the scalp, then the collision skin."""
    points, _, _ = skin_points(body, leaves)
    return torch.cat([points, scalp_vertices(body), collision_skin(body).vertices[: None if collides else 0]])


@lru_cache(maxsize=8)
def skin_to_pose(body: BodyModel, leaves: int, collides: bool) -> Skin:
    """What is posed of `posed_vertices`."""
    vertices, (_, normals, _) = posed_vertices(body, leaves, collides), skin_points(body, leaves)
    return Skin(
        body.rest_vertices[vertices].numpy(),
        body.shape_directions[:, vertices].permute(1, 2, 0).contiguous().numpy(),
        body.skin_joints[vertices].numpy(),
        body.skin_weights[vertices].contiguous().numpy(),
        normals.contiguous().numpy(),
    )
