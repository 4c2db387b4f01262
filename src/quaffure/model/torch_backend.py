"""The five steps of a drape in torch: any device, any floating type, differentiable; the gradient passes the projection
as if it had moved nothing.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import nn

from quaffure.body.collision_skin import collision_skin
from quaffure.body.head_frame import HeadFrameBody, head_frame_body_reference
from quaffure.energies.loading import Loading
from quaffure.geometry.polyline import integrate_directions
from quaffure.geometry.rotation import rotate_by_gibbs
from quaffure.model.inference_network import NetworkInputs, no_features
from quaffure.model.initial_shape import InitialShape, initial_shape_reference, strand_frames
from quaffure.model.network_config import NetworkConfig
from quaffure.model.pose_code import pose_code
from quaffure.model.prepared_groom import PreparedGroom
from quaffure.model.projection import project_reference, push_settings
from quaffure.model.strand_layers import OWN_FEATURES
from quaffure.model.surroundings import surroundings_reference
from quaffure.scene import BodyBatch
from quaffure.types import EdgeVectors, Float, Positions, Tensor


class TorchPosed(NamedTuple):
    """A batch of bodies for one groom, in the world and in the head's frame."""

    bodies: BodyBatch
    body: HeadFrameBody


class TorchBackend:
    """Steps on a batch of bodies that one groom is draped on; see `quaffure.model.neural.drape`.

    Attributes:
        projects: without it, `project` leaves hair as it is.
        push_settings: of the projection.
        network_seconds: wall time of the network alone, of all drapes so far; of what was queued on another device.
    """

    def __init__(self, network: nn.Module, loading: Loading, bf16: bool, projects: bool) -> None:
        self._network, self._loading, self._bf16 = network, loading, bf16
        self.network_seconds = 0.0
        self.config: NetworkConfig = network.config  # type: ignore[assignment]
        self.projects = projects and self.config.contact
        self.push_settings = push_settings(self.config.projection, loading.stiffness)

    def posed(self, grooms: Sequence[PreparedGroom], bodies: BodyBatch) -> Iterator[tuple[PreparedGroom, TorchPosed]]:
        """Each groom with the bodies of its rows."""
        if all(groom is grooms[0] for groom in grooms):
            yield grooms[0], TorchPosed(bodies, self.head_frame(bodies))
            return
        for row, groom in enumerate(grooms):
            own = bodies.rows(slice(row, row + 1))
            yield groom, TorchPosed(own, self.head_frame(own))

    def head_frame(self, bodies: BodyBatch) -> HeadFrameBody:
        config = self.config.initial_shape.body
        pose, shape = bodies.body_pose, bodies.body_shape
        return head_frame_body_reference(bodies.body, pose, shape, bodies.posed, config)

    def initial_shape(self, groom: PreparedGroom, posed: TorchPosed) -> InitialShape:
        shape = initial_shape_reference(groom, posed.body, self._loading, self.config.initial_shape)
        if not self.config.surroundings:
            return shape
        positions = integrate_directions(shape.roots, shape.edges, groom.rest_length)
        around = surroundings_reference(positions, groom.surroundings, self.config.density_grid).flatten(2)
        return shape._replace(features=torch.cat([shape.features, around], dim=2))

    def network(self, groom: PreparedGroom, posed: TorchPosed, shape: InitialShape) -> Tensor:
        """Rotation of the joint before every edge, see `DirectionNetwork`."""
        return self.forward(groom, posed.body, partial(self.features_after, groom, shape), shape.features)

    def features_after(
        self, groom: PreparedGroom, shape: InitialShape, changes: Float[Tensor, "b s e 3"]
    ) -> Float[Tensor, "b s columns"]:
        """Features of strands whose joints are rotated by `changes`: local features are those of the initial shape."""
        edges = rotated_edges(shape, changes)
        positions = integrate_directions(shape.roots, edges, groom.rest_length)
        features = [positions[:, :, 1:].flatten(2), shape.features[..., 3 * edges.shape[2] : OWN_FEATURES]]
        if self.config.surroundings:
            features.append(surroundings_reference(positions, groom.surroundings, self.config.density_grid).flatten(2))
        return torch.cat(features, dim=2)

    def forward(
        self, groom: PreparedGroom, body: HeadFrameBody, after: Callable[[Tensor], Tensor], *features: Tensor
    ) -> Tensor:
        begun = time.perf_counter()
        code = pose_code(self.config, body, self._loading)
        with torch.autocast(code.device.type, torch.bfloat16, enabled=self._bf16):
            changes: Tensor = self._network(NetworkInputs(groom.code, groom.texels, code, after), *features)
        self.network_seconds += time.perf_counter() - begun
        return changes

    def integrate(
        self, groom: PreparedGroom, posed: TorchPosed, shape: InitialShape, changes: Float[Tensor, "b s e 3"]
    ) -> Positions:
        """Vertices [m, world] of edges rotated by the sum of all joints before them."""
        rotation = posed.body.world_from_head[:, None].mT  # vectors are rows
        edges = rotated_edges(shape, changes) @ rotation
        roots = (shape.roots[:, :, None] @ rotation)[:, :, 0] + posed.body.head_position[:, None]
        return integrate_directions(roots, edges, groom.rest_length)

    def project(self, groom: PreparedGroom, posed: TorchPosed, hair: Positions) -> Positions:
        """Hair projected out of the skin [m, world]."""
        if not self.projects:
            return hair
        skin = collision_skin(posed.bodies.body, groom.most_clearance)
        with torch.no_grad():
            projected = [
                project_reference(own, vertices, groom, skin, self.push_settings)
                for own, vertices in zip(hair, posed.body.world_skin)
            ]
        return hair + (torch.stack(projected) - hair.detach())


def rotated_edges(shape: InitialShape, changes: Float[Tensor, "b s e 3"]) -> EdgeVectors:
    """Edges, each rotated by the changes of all joints before it."""
    turn = (0.5 * shape.compliance[..., None] * changes).cumsum(dim=2)
    # As a Gibbs vector: the rotation of the quaternion 1 + turn, but for its length.
    return rotate_by_gibbs(turn, shape.edges)


class DisplacementBackend(TorchBackend):
    """The paper's configuration: displacements of the posed groom, without contact before or after the network."""

    def __init__(self, network: nn.Module, loading: Loading, bf16: bool) -> None:
        super().__init__(network, loading, bf16, projects=False)

    def initial_shape(self, groom: PreparedGroom, posed: TorchPosed) -> InitialShape:
        """The posed groom; its features are positions alone."""
        roots, frames = strand_frames(groom.strands, posed.body)
        edges = groom.strands.edges @ frames.mT
        positions = roots[:, :, None] + torch.nn.functional.pad(edges.cumsum(dim=2), (0, 0, 1, 0))
        return InitialShape(roots, edges, torch.ones_like(edges[..., 0]), positions.flatten(2))

    def network(self, groom: PreparedGroom, posed: TorchPosed, shape: InitialShape) -> Tensor:
        """Displacement of every vertex [m]; roots do not move."""
        moved = self.forward(groom, posed.body, no_features)
        return torch.cat([torch.zeros_like(moved[:, :, :1]), moved[:, :, 1:]], dim=2)

    def integrate(self, groom: PreparedGroom, posed: TorchPosed, shape: InitialShape, changes: Positions) -> Positions:
        """Displaced vertices [m, world]."""
        positions = shape.features.unflatten(2, (-1, 3)) + changes
        return positions @ posed.body.world_from_head[:, None].mT + posed.body.head_position[:, None, None]
