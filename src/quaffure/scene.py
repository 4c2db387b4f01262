"""One groom on a batch of posed bodies: what every draper starts from."""

from dataclasses import dataclass, replace
from functools import cached_property

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.body.kinematics import PosedJoints, pose_joints
from quaffure.body.pose_features import HEAD
from quaffure.geometry.occupancy_grid import OccupancyGrid
from quaffure.geometry.polyline import directors
from quaffure.geometry.surface import Surface, posed_surface
from quaffure.hair.groom import Groom
from quaffure.hair.posing import posed_strands
from quaffure.types import BodyPose, BodyShape, EdgeVectors, Positions


@dataclass(frozen=True, eq=False)
class BodyBatch:
    """A batch of poses and shapes of one body, which several grooms may share. What is asked for is made once.

    Attributes:
        body_pose: theta [rad].
        body_shape: beta [standard deviations].
    """

    body: BodyModel
    body_pose: BodyPose
    body_shape: BodyShape

    @cached_property
    def joints(self) -> PosedJoints:
        """Forward kinematics, once for everything that reads these bodies."""
        return pose_joints(self.body, self.body_pose, self.body_shape)

    @cached_property
    def posed(self) -> PosedBody:
        _, rotations, positions = self.joints
        return self.body.skin(self.body_shape, rotations.to(self.body.rest_joints), positions.to(self.body.rest_joints))

    def rows(self, rows: slice) -> "BodyBatch":
        """Some of the bodies, not posed again."""
        part = BodyBatch(self.body, self.body_pose[rows], self.body_shape[rows])
        part.__dict__["joints"] = self.joints.rows(rows)
        return part

    @cached_property
    def surface(self) -> Surface:
        """The skins, ready for nearest-face searches."""
        head = self.posed.joint_positions[:, self.body.joint_names.index(HEAD)]
        return posed_surface(self.body.surface_topology, self.posed.vertices, head)

    def sample(self, index: int) -> "BodyBatch":
        """One sample as a batch of its own; its surface is cut out of the batch's and not made again."""
        one = slice(index, index + 1)
        alone = self.rows(one)
        alone.__dict__["surface"] = _surface_of(self.surface, one)
        return alone


@dataclass(frozen=True, eq=False)
class Scene:
    """A groom on a batch of bodies. What is asked for is made once."""

    groom: Groom
    bodies: BodyBatch

    @cached_property
    def posed(self) -> Positions:
        """x_posed, the groom moved with its scalp triangles [m, world]."""
        return posed_strands(self.groom, self.bodies.posed, self.bodies.body)

    @cached_property
    def director(self) -> EdgeVectors:
        """Unit director d3 of every edge."""
        return directors(self.posed)

    @property
    def surface(self) -> Surface:
        return self.bodies.surface

    def sample(self, index: int) -> "Scene":
        """One sample as a scene of its own, the same to the bit: cut out of this one and not posed again."""
        one = slice(index, index + 1)
        alone = Scene(self.groom, self.bodies.sample(index))
        alone.__dict__.update(posed=self.posed[one], director=self.director[one])
        return alone


def _surface_of(surface: Surface, samples: slice) -> Surface:
    wide, space = surface.wide, surface.map
    return replace(
        surface,
        vertices=surface.vertices[samples],
        corners=surface.corners[samples],
        bounds=surface.bounds[samples],
        normals=surface.normals[samples],
        wide=wide._replace(blocks=wide.blocks[samples], boxes=wide.boxes[samples]),
        map=OccupancyGrid(*(field[samples] for field in space)),
    )
