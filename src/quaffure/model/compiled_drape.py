"""Drapes without gradient on the CPU: compiled kernels before and after the network, many grooms in one batch of it."""

import time
from collections.abc import Sequence
from typing import no_type_check

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.body.body_model import BodyModel
from quaffure.body.collision_skin import collision_skin
from quaffure.body.head_frame import HeadFrameBody, head_frame_body, posed_skin
from quaffure.config import EDGES_PER_STRAND, HairMaterial
from quaffure.geometry.mls_surface import FAST, MlsPoints, mls_points
from quaffure.model.inference_network import InferenceNetwork
from quaffure.model.initial_shape import InitialShape, bits, fill_initial_shape
from quaffure.model.prepared_groom import PackedGroom
from quaffure.model.projection import project
from quaffure.model.quaffure_network import POSE_SIZE, SHAPE_SIZE
from quaffure.types import BodyPose, BodyShape, Float, Tensor

BATCH = 8
"""Drapes whose textures the decoder makes at once; more are not faster, and take more memory."""


class CompiledDrape:
    """`NeuralDraper.deform` and `projected` as kernels.

    Attributes:
        network: laid out for speed.
        material: the one that the network was trained for.
        network_seconds: wall time of the network alone, of all drapes so far.
    """

    def __init__(self, network: InferenceNetwork, material: HairMaterial) -> None:
        self.network, self.material, self.network_seconds = network, material, 0.0

    def drape(
        self,
        grooms: Sequence[PackedGroom],
        body: BodyModel,
        body_pose: BodyPose,
        body_shape: BodyShape,
        draped: Sequence[Tensor],
    ) -> None:
        """Drape each groom on the body of its row.

        Args:
            draped: [strand, vertex, 3] for each groom, filled [m, world].
        """
        view = head_frame_body(body, body_pose, body_shape)
        records = mls_points(view.surface)
        begun = time.perf_counter()
        textures = self.textures(grooms, view)
        self.network_seconds += time.perf_counter() - begun
        buffers = self.buffers(max(len(groom.texels) for groom in grooms))
        for sample, (groom, out) in enumerate(zip(grooms, draped)):
            one = slice(sample, sample + 1)
            seen = MlsPoints(records.points[one], records.places[one])
            start = self.start(groom, view.sample(sample), seen, buffers)
            begun = time.perf_counter()
            answers = self.network.answers(textures[sample], groom.texels, start.told[0])
            self.network_seconds += time.perf_counter() - begun
            self.end(groom, start, answers, view.sample(sample), out)
        if self.network.config.slides:
            skin, (vertices, heads) = collision_skin(body), posed_skin(body, body_pose, body_shape)
            for groom, out, skin_vertices, head in zip(grooms, draped, vertices, heads):
                project(out.clone(), skin_vertices, groom.rest_length, groom.clearance, skin, head, out)

    def textures(self, grooms: Sequence[PackedGroom], view: HeadFrameBody) -> Float[Tensor, "b texels channels"]:
        """What the decoder says of each groom on its body."""
        pose_code = view.pose_code[:, : SHAPE_SIZE + POSE_SIZE + self.network.config.pose_features]
        return self.network.textures(torch.cat([torch.stack([groom.code for groom in grooms]), pose_code], dim=1))

    def buffers(self, rows: int) -> InitialShape:
        """Where grooms of up to so many rows can start, one after another: memory in use is still in the cache."""
        told = self.network.inputs(rows)[None]
        edges = torch.empty(1, rows, EDGES_PER_STRAND, 3)
        return InitialShape(torch.empty(1, rows, 3), edges, torch.empty(1, rows, EDGES_PER_STRAND), told)

    def start(self, groom: PackedGroom, view: HeadFrameBody, records: MlsPoints, buffers: InitialShape) -> InitialShape:
        """A groom before the network, row by row, on the one body of `view`; lies in `buffers`."""
        rows = len(groom.texels)
        start = InitialShape(*(field[:, :rows] for field in buffers))
        place = np.arange(rows, dtype=np.int32).reshape(groom.packets.strand.shape)
        fill_initial_shape(groom.packets, place, view, records, self.material, start)
        return start

    @staticmethod
    def end(
        groom: PackedGroom,
        start: InitialShape,
        answers: Float[Tensor, "row answers"],
        view: HeadFrameBody,
        draped: Float[Tensor, "s n 3"],
    ) -> None:
        """Answers to vertices in the world."""
        finish(
            start.edges[0].numpy(), start.compliance[0].numpy(), bits(answers), groom.rest_length.numpy(),
            start.roots[0].numpy(), groom.packets.strand.reshape(-1), view.world_from_head[0].numpy(),
            view.head[0].numpy(), get_num_threads(), draped.numpy(),
        )  # fmt: skip


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def finish(
    edges: np.ndarray, compliance: np.ndarray, answers: np.ndarray, rest_length: np.ndarray, roots: np.ndarray,
    strand: np.ndarray, world_from_head: np.ndarray, head: np.ndarray, threads: int, draped: np.ndarray,
) -> None:  # fmt: skip
    """Turn edges by the network's answers, put them one after another and carry them into the world.

    Args:
        answers: the bits of float32, or of bfloat16.
        strand: which strand of `rest_length` and `draped` each row of the others is.
    """
    count, columns = edges.shape[1], answers.shape[1]
    room, shift = np.empty((threads, columns), np.uint32), np.uint32(32 - 8 * answers.itemsize)
    a, b, c = world_from_head[0], world_from_head[1], world_from_head[2]
    for thread in prange(threads):
        bits, answer = room[thread], room[thread].view(np.float32)
        for row in range(thread, len(rest_length), threads):  # the rows after these repeat the last strand
            for k in range(columns):
                bits[k] = np.uint32(answers[row, k]) << shift
            own, x, y, z = strand[row], roots[row, 0], roots[row, 1], roots[row, 2]
            for vertex in range(count + 1):
                draped[own, vertex, 0] = head[0] + a[0] * x + a[1] * y + a[2] * z
                draped[own, vertex, 1] = head[1] + b[0] * x + b[1] * y + b[2] * z
                draped[own, vertex, 2] = head[2] + c[0] * x + c[1] * y + c[2] * z
                if vertex < count:
                    yielding = compliance[row, vertex]
                    ux = edges[row, vertex, 0] + yielding * answer[3 * vertex]
                    uy = edges[row, vertex, 1] + yielding * answer[3 * vertex + 1]
                    uz = edges[row, vertex, 2] + yielding * answer[3 * vertex + 2]
                    scale = rest_length[own, vertex] / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
                    x, y, z = x + scale * ux, y + scale * uy, z + scale * uz
