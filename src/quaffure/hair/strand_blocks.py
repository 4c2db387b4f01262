"""A groom's rest strands in SIMD blocks of sixteen neighbours, as compiled kernels read them.

A kernel works on a block at once, a strand in each lane of the processor's vectors; neighbours read the same part of
the skin. Edges are in the frame of the scalp triangle that carries the strand, where no pose changes them.
"""

from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.head_frame import scalp_vertices
from quaffure.errors import InputError
from quaffure.geometry.mls_surface import LANES
from quaffure.hair.groom import Groom
from quaffure.hair.posing import root_positions, triangle_frames
from quaffure.types import Float, Int, Tensor


class RestStrands(NamedTuple):
    """Strands in the frames of the scalp triangles that carry them.

    Attributes:
        edges: rest edges [m].
        offset: first vertex, from its position on the triangle [m].
        corners: of the triangle, as indices of `scalp_vertices`.
        barycentric: position on the triangle.
    """

    edges: Float[Tensor, "s e 3"]
    offset: Float[Tensor, "s 3"]
    corners: Int[Tensor, "s 3"]
    barycentric: Float[Tensor, "s 3"]


class StrandBlocks(NamedTuple):
    """`RestStrands` in blocks; the last block repeats the last strand to fill its lanes.

    Attributes:
        strand: index of the strand in each lane.
        edges, offset, corners, barycentric: see `RestStrands`.
        margin: distance from the body that the far vertex of each edge is to keep [m].
    """

    strand: Int[np.ndarray, "block lane"]
    edges: Float[np.ndarray, "block e 3 lane"]
    offset: Float[np.ndarray, "block 3 lane"]
    corners: Int[np.ndarray, "block 3 lane"]
    barycentric: Float[np.ndarray, "block 3 lane"]
    margin: Float[np.ndarray, "block e lane"]


def rest_strands(groom: Groom, body: BodyModel) -> RestStrands:
    """A groom in the frames of its scalp triangles.

    Raises:
        InputError: a root that is not on the scalp.
    """
    carriers, vertices = body.faces[groom.root_faces], scalp_vertices(body)
    corners = torch.searchsorted(vertices, carriers).clamp(max=len(vertices) - 1)
    if not torch.equal(vertices[corners], carriers):
        raise InputError(groom.name, "roots on the scalp", "roots elsewhere")
    frames = triangle_frames(body.rest_vertices[carriers])
    offset = (groom.rest_strands[:, 0] - root_positions(groom, body.rest_vertices[None], body)[0])[:, None] @ frames
    return RestStrands(groom.rest_strands.diff(dim=1) @ frames, offset[:, 0], corners, groom.root_barycentric)


def strand_blocks(strands: RestStrands, margin: Float[Tensor, "s n"], order: Int[Tensor, " m"]) -> StrandBlocks:
    """Some strands in an order, near ones next to each other."""
    order = torch.cat([order, order[-1:].expand(-len(order) % LANES)])
    edges, offset, corners, barycentric = (values[order] for values in strands)
    parts = (order.int(), edges, offset, corners.int(), barycentric, margin[order, 1:])
    return StrandBlocks(*(in_blocks(values) for values in parts))


def in_blocks(values: Tensor) -> np.ndarray:
    """[strand, ...] to [block, ..., lane]."""
    return np.ascontiguousarray(values.detach().unflatten(0, (-1, LANES)).movedim(1, -1).numpy())
