"""The five steps of a drape as compiled float32 kernels on the CPU, many grooms in one batch of the network.

Shapes cannot be checked at run time inside compiled code, hence `no_type_check`.
"""

import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple, no_type_check

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.body.collision_skin import CollisionSkin, collision_skin
from quaffure.body.head_frame import HeadFrameBody, head_frame_body, head_frame_joints, posed_skin
from quaffure.config import EDGES_PER_STRAND, HairMaterial
from quaffure.geometry.mls_surface import FAST, mls_points
from quaffure.model.initial_shape import InitialShape, bits, body_arrays, empty_shape, fill_initial_shape
from quaffure.model.initial_shape_kernels import BodyArrays
from quaffure.model.prepared_groom import PreparedGroom
from quaffure.model.projection import project
from quaffure.model.quaffure_network import DirectionNetwork
from quaffure.model.torch_backend import TorchBackend, TorchPosed
from quaffure.scene import BodyBatch
from quaffure.types import Float, Positions, Tensor

BATCH = 8
"""Drapes whose textures the decoder makes at once; more are not faster, and take more memory."""


class CpuPosed(NamedTuple):
    """The body of one drape.

    Attributes:
        bodies: for the initial shape, in the head's frame; a batch of one.
        world_from_head, head: the head's rotation and its joint [m].
        encoded: by the network.
        skin: faces that hair is projected out of, None where it is not.
        vertices: of the skin, posed [m, world].
        memory: for the initial shape; of all drapes of a batch, so that it is still in the processor's cache.
    """

    bodies: BodyArrays
    world_from_head: Float[Tensor, "3 3"]
    head: Float[Tensor, "3"]
    encoded: object
    skin: CollisionSkin | None
    vertices: Float[Tensor, "v 3"] | None
    memory: InitialShape


class CpuBackend:
    """Steps of one drape after another; see `quaffure.model.neural.drape`.

    Attributes:
        layout: the network with the weights that it had when this was made.
        network_seconds: wall time of the network alone, of all drapes so far.
    """

    def __init__(self, network: DirectionNetwork, material: HairMaterial, bf16: bool) -> None:
        self.config, self._material = network.config, material
        self.layout, self.network_seconds = network.for_inference(bf16), 0.0
        self._clearance = self.config.projection.clearance_share * material.collision_margin

    def posed(self, grooms: Sequence[PreparedGroom], bodies: BodyBatch) -> Iterator[tuple[PreparedGroom, CpuPosed]]:
        """Each groom with the body of its row; bodies are posed, and grooms encoded, `BATCH` at a time."""
        body, config = bodies.body, self.config
        for first in range(0, len(grooms), BATCH):
            part, rows = grooms[first : first + BATCH], slice(first, first + BATCH)
            pose, shape = bodies.body_pose[rows], bodies.body_shape[rows]
            joints = head_frame_joints(body, pose, shape, bodies.joints.rows(rows))
            head = head_frame_body(body, joints, config.initial_shape.body)
            arrays = body_arrays(head, mls_points(head.surface), self._material, config.initial_shape)
            skin = collision_skin(body, self._clearance) if config.contact else None
            vertices = posed_skin(body, joints) if config.contact else [None] * len(part)
            encoded, memory = self.encode(part, head), self.memory(part)
            for row, groom in enumerate(part):
                frame = head.world_from_head[row], head.head[row]
                yield groom, CpuPosed(arrays.row(row), *frame, encoded[row], skin, vertices[row], memory)

    def encode(self, grooms: Sequence[PreparedGroom], bodies: HeadFrameBody) -> Sequence[object]:
        """The part of the network that runs once for a batch."""
        begun = time.perf_counter()
        encoded = self.layout.encode(torch.stack([groom.code for groom in grooms]), bodies.pose_code)
        self.network_seconds += time.perf_counter() - begun
        return encoded

    def memory(self, grooms: Sequence[PreparedGroom]) -> InitialShape:
        """Memory for the initial shape of any of these grooms."""
        rows = max(groom.blocks.rows.size for groom in grooms)
        return empty_shape(1, rows, EDGES_PER_STRAND)._replace(features=self.layout.features(rows)[None])

    def initial_shape(self, groom: PreparedGroom, posed: CpuPosed) -> InitialShape:
        """Row by row of the kernels' blocks."""
        rows, (roots, edges, compliance, features) = groom.blocks.rows, posed.memory
        count = rows.size
        shape = InitialShape(roots[:, :count], edges[:, :count], compliance[:, :count], features[:, :count])
        fill_initial_shape(groom.blocks, rows, posed.bodies, shape)
        return shape

    def network(self, groom: PreparedGroom, posed: CpuPosed, shape: InitialShape) -> Float[Tensor, "row outputs"]:
        """Change of every edge's direction."""
        begun = time.perf_counter()
        changes = self.layout.changes(posed.encoded, groom.blocks.texels, shape.features[0])
        self.network_seconds += time.perf_counter() - begun
        return changes

    def integrate(
        self, groom: PreparedGroom, posed: CpuPosed, shape: InitialShape, changes: Float[Tensor, "row outputs"]
    ) -> Positions:
        """Vertices [m, world] of edges that have changed their directions."""
        hair, strand = torch.empty(1, *groom.margin.shape, 3), groom.blocks.strands.strand.reshape(-1)
        _integrate(
            _ShapeRows(shape.roots[0].numpy(), shape.edges[0].numpy(), shape.compliance[0].numpy(), strand),
            bits(changes), groom.rest_length.numpy(), posed.world_from_head.numpy(), posed.head.numpy(),
            get_num_threads(), hair[0].numpy(),
        )  # fmt: skip
        return hair

    def project(self, groom: PreparedGroom, posed: CpuPosed, hair: Positions) -> Positions:
        """Hair projected out of the skin [m, world]."""
        if posed.skin is None or posed.vertices is None:
            return hair
        strands, config = (hair[0], posed.vertices, groom.rest_length, groom.clearance), self.config.projection
        return project(*strands, posed.skin, posed.head, config)[None]


class CpuTrainingBackend(TorchBackend):
    """The initial shape from the compiled kernels, without gradient, the rest in torch; no projection."""

    def head_frame(self, bodies: BodyBatch) -> HeadFrameBody:
        joints = head_frame_joints(bodies.body, bodies.body_pose, bodies.body_shape, bodies.joints)
        return head_frame_body(bodies.body, joints, self.config.initial_shape.body)

    def initial_shape(self, groom: PreparedGroom, posed: TorchPosed) -> InitialShape:
        config, (strands, vertices) = self.config.initial_shape, groom.margin.shape
        shape = empty_shape(len(posed.body.head), strands, vertices - 1)
        arrays = body_arrays(posed.body, mls_points(posed.body.surface), self._material, config)
        fill_initial_shape(groom.blocks, groom.blocks.strands.strand, arrays, shape)
        return shape


class _ShapeRows(NamedTuple):
    """Rows of an `InitialShape`, and the strand of each."""

    roots: np.ndarray
    edges: np.ndarray
    compliance: np.ndarray
    strand: np.ndarray


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _integrate(
    shape: _ShapeRows, changes: np.ndarray, rest_length: np.ndarray, world_from_head: np.ndarray, head: np.ndarray,
    threads: int, hair: np.ndarray,
) -> None:  # fmt: skip
    """Change edges by the network's outputs, put them one after another and transform them into the world.

    Args:
        changes: the bits of float32, or of bfloat16.
        hair: filled, in the order of `rest_length`.
    """
    edges, compliance = shape.edges, shape.compliance
    count, columns = edges.shape[1], changes.shape[1]
    spaces, shift = np.empty((threads, columns), np.uint32), np.uint32(32 - 8 * changes.itemsize)
    a, b, c = world_from_head[0], world_from_head[1], world_from_head[2]
    for thread in prange(threads):
        bits, change = spaces[thread], spaces[thread].view(np.float32)
        for row in range(thread, len(rest_length), threads):  # the rows after these repeat the last strand
            for k in range(columns):
                bits[k] = np.uint32(changes[row, k]) << shift
            own, x, y, z = shape.strand[row], shape.roots[row, 0], shape.roots[row, 1], shape.roots[row, 2]
            for vertex in range(count + 1):
                hair[own, vertex, 0] = head[0] + a[0] * x + a[1] * y + a[2] * z
                hair[own, vertex, 1] = head[1] + b[0] * x + b[1] * y + b[2] * z
                hair[own, vertex, 2] = head[2] + c[0] * x + c[1] * y + c[2] * z
                if vertex < count:
                    compliant = compliance[row, vertex]
                    ux = edges[row, vertex, 0] + compliant * change[3 * vertex]
                    uy = edges[row, vertex, 1] + compliant * change[3 * vertex + 1]
                    uz = edges[row, vertex, 2] + compliant * change[3 * vertex + 2]
                    scale = rest_length[own, vertex] / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
                    x, y, z = x + scale * ux, y + scale * uy, z + scale * uz
