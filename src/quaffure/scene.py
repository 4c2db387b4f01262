"""One groom on a batch of posed bodies: what drapers, energies and solvers read."""

from dataclasses import dataclass
from functools import cached_property

import torch

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.body.kinematics import PosedJoints, pose_joints
from quaffure.body.pose_features import HEAD
from quaffure.body.pose_limits import JOINT_COUNT, SHAPE_COUNT, Rows, check_body_pose, check_body_shape, tensor_of
from quaffure.errors import InputError
from quaffure.geometry.polyline import directors
from quaffure.geometry.surface import Surface, posed_surface
from quaffure.hair.groom import Groom
from quaffure.hair.groom_checks import check_groom
from quaffure.hair.posing import posed_strands, rigid_rotations, root_rotations
from quaffure.types import BodyPose, BodyShape, EdgeVectors, Float, MeshVertices, Positions, Tensor


@dataclass(frozen=True, eq=False, init=False)
class BodyBatch:
    """A batch of poses and shapes of one body, which several grooms may share. Properties are computed once, when read.

    Attributes:
        body_pose: theta [rad].
        body_shape: beta [standard deviations].
        offsets: change of the surface at rest, before it is posed [m] (`quaffure.body.surface_morphs`); none without.
        vertices: of the posed surfaces, where they are known otherwise, as from the file of a drape [m, world].

    Poses and shapes may be arrays or lists, which become tensors; tensors are kept as they are.

    Raises:
        InputError: no numbers, or poses and shapes of another width or that no body has (`quaffure.body.pose_limits`).
    """

    body: BodyModel
    body_pose: BodyPose
    body_shape: BodyShape
    offsets: Float[Tensor, "b v 3"] | None = None
    vertices: MeshVertices | None = None

    def __init__(
        self,
        body: BodyModel,
        body_pose: Rows,
        body_shape: Rows,
        offsets: Float[Tensor, "b v 3"] | None = None,
        vertices: MeshVertices | None = None,
    ) -> None:
        pose, shape = body_pose, body_shape
        if not isinstance(pose, Tensor):
            pose = tensor_of(pose, "body_pose").to(body.rest_vertices)
        if not isinstance(shape, Tensor):
            shape = tensor_of(shape, "body_shape").to(body.rest_vertices)
        batch = pose.shape[0] if pose.ndim else 0
        expected = [batch, 3 * JOINT_COUNT], [batch, SHAPE_COUNT]
        if (list(pose.shape), list(shape.shape)) != expected:
            found = f"{list(pose.shape)} and {list(shape.shape)}"
            raise InputError("body_pose and body_shape", f"numbers {expected[0]} and {expected[1]}", found)
        check_body_pose(pose, "body_pose")
        check_body_shape(shape, "body_shape")
        vars(self).update(body=body, body_pose=pose, body_shape=shape, offsets=offsets, vertices=vertices)

    @cached_property
    def joints(self) -> PosedJoints:
        """Forward kinematics, once for everything that reads these bodies."""
        return pose_joints(self.body, self.body_pose, self.body_shape)

    @cached_property
    def posed(self) -> PosedBody:
        _, rotations, positions = (joints.to(self.body.rest_joints) for joints in self.joints)
        if self.vertices is not None:
            return PosedBody(self.vertices, rotations, positions)
        return self.body.skin(self.body_shape, rotations, positions, self.offsets)

    def rows(self, rows: slice) -> "BodyBatch":
        """Some of the bodies; their joints are not posed again, their skins are."""
        surfaces = (None if values is None else values[rows] for values in (self.offsets, self.vertices))
        part = BodyBatch(self.body, self.body_pose[rows], self.body_shape[rows], *surfaces)
        part.__dict__["joints"] = self.joints.rows(rows)
        return part

    @cached_property
    def surface(self) -> Surface:
        """The skins with their search structures."""
        head = self.posed.joint_positions[:, self.body.joint_names.index(HEAD)]
        return posed_surface(self.body.surface_topology, self.posed.vertices, head)


@dataclass(frozen=True, eq=False)
class PosedScene:
    """A groom whose posed strands and body surface are known: all that energies and solvers read.

    Attributes:
        posed: x_posed, the groom moved with its scalp triangles [m, world].
        surface: skins of the posed bodies.
        rotation: of every scalp triangle from rest; fitted to the posed strands where none is given.
    """

    groom: Groom
    posed: Positions
    surface: Surface
    rotation: Float[Tensor, "b s 3 3"] | None = None

    @cached_property
    def root_rotation(self) -> Float[Tensor, "b s 3 3"]:
        """Rotation of every strand from rest to its pose (world_from_rest)."""
        return rigid_rotations(self.groom, self.posed) if self.rotation is None else self.rotation

    @cached_property
    def director(self) -> EdgeVectors:
        """Unit director d3 of every edge."""
        return directors(self.posed)

    def sample(self, index: int) -> "PosedScene":
        """One sample as a scene of its own, the same to the bit."""
        one = slice(index, index + 1)
        rotation = None if self.rotation is None else self.rotation[one]
        return PosedScene(self.groom, self.posed[one], self.surface.samples(one), rotation)


@dataclass(frozen=True, eq=False)
class Scene:
    """A groom on a batch of bodies. Properties are computed once, when read; where that is done with gradient, they are
    differentiable in pose and shape.

    Raises:
        InputError: a groom that no hair can be computed of (`quaffure.hair.groom_checks.check_groom`).
    """

    groom: Groom
    bodies: BodyBatch

    def __post_init__(self) -> None:
        check_groom(self.groom, len(self.bodies.body.faces))

    @cached_property
    def posed(self) -> Positions:
        """x_posed, the groom moved with its scalp triangles [m, world]."""
        return posed_strands(self.groom, self.bodies.posed, self.bodies.body, self.root_rotation)

    @cached_property
    def root_rotation(self) -> Float[Tensor, "b s 3 3"]:
        """Rotation of every strand's scalp triangle from rest to its pose (world_from_rest)."""
        return root_rotations(self.groom, self.bodies.posed, self.bodies.body)

    @cached_property
    def director(self) -> EdgeVectors:
        """Unit director d3 of every edge."""
        return directors(self.posed)

    @property
    def surface(self) -> Surface:
        return self.bodies.surface

    def sample(self, index: int) -> PosedScene:
        """One sample as a scene of its own, the same to the bit: a part of this one, not posed again."""
        return PosedScene(self.groom, self.posed, self.surface, self.root_rotation).sample(index)


HairScene = Scene | PosedScene


def check_gradient(scene: "HairScene") -> None:
    """Refuse to differentiate a scene in a pose or shape without whose gradient it was posed before.

    Raises:
        ValueError: it was first read under `torch.no_grad`, as drapers and metrics do.
    """
    if not (isinstance(scene, Scene) and torch.is_grad_enabled()):
        return
    bodies = scene.bodies
    if (bodies.body_pose.requires_grad or bodies.body_shape.requires_grad) and not scene.posed.requires_grad:
        raise ValueError("expected a scene posed with gradient, found one first read under torch.no_grad; make another")
