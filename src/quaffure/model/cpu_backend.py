"""The five steps of a drape as compiled float32 kernels on the CPU, many grooms in one batch of the network."""

import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import get_num_threads

from quaffure.body.collision_skin import CollisionSkin, collision_skin
from quaffure.body.head_frame import HeadFrameBody, head_frame_body
from quaffure.body.kinematics import PosedJoints
from quaffure.energies.loading import Loading
from quaffure.model.initial_shape import InitialShape, bits, empty_shape, fill_initial_shape
from quaffure.model.integration_kernel import ShapeRows, integrate_edges, rotate_edges
from quaffure.model.pose_code import pose_code
from quaffure.model.prepared_groom import PreparedGroom
from quaffure.model.projection import project, push_settings
from quaffure.model.quaffure_network import DirectionNetwork
from quaffure.model.strand_layers import OWN_FEATURES, feature_size
from quaffure.model.surroundings import grid_units
from quaffure.model.surroundings_kernels import GridUnits, write_surroundings
from quaffure.model.torch_backend import TorchBackend, TorchPosed
from quaffure.scene import BodyBatch
from quaffure.types import Float, Positions, Tensor

BATCH = 8
"""Drapes whose textures the decoder makes at once; more are not faster, and take more memory."""


class CpuPosed(NamedTuple):
    """The body of one drape.

    Attributes:
        body: a batch of one.
        texture: of the strands' codes, by the network's decoder.
        memory: for the initial shape; of all drapes of a batch, so that it is still in the processor's cache.
        skin: faces that hair is projected out of.
    """

    body: HeadFrameBody
    texture: Any
    memory: InitialShape
    skin: CollisionSkin


class CpuBackend:
    """Steps of one drape after another; see `quaffure.model.neural.drape`.

    Attributes:
        layout: the network with the weights that it had when this was made.
        network_seconds: wall time of the network alone, of all drapes so far.
    """

    def __init__(self, network: DirectionNetwork, loading: Loading, bf16: bool) -> None:
        self.config, self._loading = network.config, loading
        self.layout: Any = network.for_inference(bf16)
        self._grid = grid_units(network.config.density_grid)
        self._push_settings = push_settings(network.config.projection, loading.stiffness)
        self.network_seconds = 0.0

    def posed(self, grooms: Sequence[PreparedGroom], bodies: BodyBatch) -> Iterator[tuple[PreparedGroom, CpuPosed]]:
        """Each groom with the body of its row; bodies are posed, and textures decoded, `BATCH` at a time."""
        body, config = bodies.body, self.config
        rest, rotations, positions = bodies.joints
        for first in range(0, len(grooms), BATCH):
            part, rows = grooms[first : first + BATCH], slice(first, first + BATCH)
            joints = PosedJoints(rest[rows], rotations[rows], positions[rows])
            pose, shape = bodies.body_pose[rows], bodies.body_shape[rows]
            offsets = None if bodies.offsets is None else bodies.offsets[rows]
            batch = head_frame_body(body, pose, shape, joints, config.initial_shape.body, config.contact, offsets)
            codes, most = [], 0
            for groom in part:
                codes.append(groom.code)
                most = max(most, groom.blocks.rows.size)
            begun = time.perf_counter()
            pose_codes = pose_code(config, batch, self._loading)
            texture = self.layout.decode_texture(torch.stack(codes), pose_codes)
            self.network_seconds += time.perf_counter() - begun
            memory = empty_shape(1, most, self.layout.columns, self.layout.dtype)
            for row, groom in enumerate(part):
                skin = collision_skin(body, groom.most_clearance)
                yield groom, CpuPosed(batch.sample(row), texture[row], memory, skin)

    def initial_shape(self, groom: PreparedGroom, posed: CpuPosed) -> InitialShape:
        """Row by row of the kernels' blocks."""
        rows, (roots, edges, compliance, features) = groom.blocks.rows, posed.memory
        count = rows.size
        shape = InitialShape(roots[:, :count], edges[:, :count], compliance[:, :count], features[:, :count])
        fill_initial_shape(groom.blocks, rows, posed.body, self._loading, self.config.initial_shape, shape)
        if self.config.surroundings:
            around = bits(shape.features)[..., OWN_FEATURES:]
            own_roots, own_edges = shape.roots.numpy(), shape.edges.numpy()
            write_surroundings(groom.blocks.surroundings, own_roots, own_edges, self._grid, get_num_threads(), around)
        return shape

    def network(self, groom: PreparedGroom, posed: CpuPosed, shape: InitialShape) -> Float[Tensor, "row outputs"]:
        """Rotation of the joint before every edge, see `DirectionNetwork`. Refinements overwrite the features."""
        begun = time.perf_counter()
        rewrite = partial(rewrite_features, groom.blocks.surroundings, shape, self._grid)
        changes = self.layout.changes(posed.texture, groom.blocks.texels, shape.features[0], rewrite)
        self.network_seconds += time.perf_counter() - begun
        return changes

    def integrate(
        self, groom: PreparedGroom, posed: CpuPosed, shape: InitialShape, changes: Float[Tensor, "row outputs"]
    ) -> Positions:
        """Vertices [m, world] of edges rotated by the sum of all joints before them."""
        strand, body = groom.blocks.strands.strand.reshape(-1), posed.body
        rows = ShapeRows(shape.roots[0].numpy(), shape.edges[0].numpy(), shape.compliance[0].numpy())
        frame = body.world_from_head[0].numpy(), body.head_position[0].numpy()
        lengths, threads = groom.rest_length.numpy(), get_num_threads()
        return torch.from_numpy(integrate_edges(rows, bits(changes), strand, lengths, *frame, threads))[None]

    def project(self, groom: PreparedGroom, posed: CpuPosed, hair: Positions) -> Positions:
        """Hair projected out of the skin [m, world]."""
        if not self.config.contact:
            return hair
        body, rods = posed.body, groom.blocks.pushed
        return project(hair[0], body.world_skin[0], rods, posed.skin, body.head_position[0], self._push_settings)[None]


def rewrite_features(
    strands: tuple[np.ndarray, ...], shape: InitialShape, grid: GridUnits, changes: Float[Tensor, "*b row outputs"]
) -> None:
    """Positions and surroundings in the features of a shape as `changes` leave it, see `TorchBackend.features_after`.

    Args:
        strands: `quaffure.model.surroundings.Surroundings` of the rows.
    """
    roots, edges, compliance, features = shape
    rotated, columns = np.empty(edges.shape, np.float32), bits(features)
    of_samples = bits(changes.view(len(roots), *changes.shape[-2:]))
    for sample, turned in enumerate(rotated):
        rows = ShapeRows(roots[sample].numpy(), edges[sample].numpy(), compliance[sample].numpy())
        rotate_edges(rows, of_samples[sample], strands[0], get_num_threads(), turned, columns[sample])
    around = columns[..., OWN_FEATURES:]
    if around.size:  # networks that read no surroundings have no such columns
        write_surroundings(strands, roots.numpy(), rotated, grid, get_num_threads(), around)


class CpuTrainingBackend(TorchBackend):
    """Initial shape and projection by the compiled kernels, without gradient, the rest in torch."""

    def head_frame(self, bodies: BodyBatch) -> HeadFrameBody:
        config, joints, moved = self.config.initial_shape.body, bodies.joints, bodies.offsets
        return head_frame_body(bodies.body, bodies.body_pose, bodies.body_shape, joints, config, self.projects, moved)

    def initial_shape(self, groom: PreparedGroom, posed: TorchPosed) -> InitialShape:
        shape = empty_shape(
            len(posed.body.head_position), len(groom.initial_clearance), feature_size(self.config), torch.float32
        )
        config, rows = self.config.initial_shape, groom.blocks.strands.strand
        fill_initial_shape(groom.blocks, rows, posed.body, self._loading, config, shape)
        if self.config.surroundings:
            around = bits(shape.features)[..., OWN_FEATURES:]
            strands, grid = tuple(map(Tensor.numpy, groom.surroundings)), grid_units(self.config.density_grid)
            write_surroundings(strands, shape.roots.numpy(), shape.edges.numpy(), grid, get_num_threads(), around)
        return shape

    def features_after(
        self, groom: PreparedGroom, shape: InitialShape, changes: Float[Tensor, "b s e 3"]
    ) -> Float[Tensor, "b s columns"]:
        """See `TorchBackend.features_after`; without gradient."""
        after, strands = shape._replace(features=shape.features.clone()), tuple(map(Tensor.numpy, groom.surroundings))
        rewrite_features(strands, after, grid_units(self.config.density_grid), changes.detach().flatten(2))
        return after.features

    def project(self, groom: PreparedGroom, posed: TorchPosed, hair: Positions) -> Positions:
        """Hair projected out of the skin [m, world], to which the gradient passes as if it had not been moved."""
        if not self.projects:
            return hair
        skin, settings = collision_skin(posed.bodies.body, groom.most_clearance), self.push_settings
        projected = [
            project(own, vertices, groom.blocks.pushed, skin, head, settings)
            for own, vertices, head in zip(hair.detach(), posed.body.world_skin, posed.body.head_position)
        ]
        return hair + (torch.stack(projected) - hair.detach())
