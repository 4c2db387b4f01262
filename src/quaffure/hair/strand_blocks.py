"""A groom's rest strands in SIMD blocks of sixteen neighbours, as compiled kernels read them.

A kernel works on a block at once, a strand in each lane of the processor's vectors; neighbours read the same part of
the skin. Edges are in the frame in which the strand moves rigidly (`quaffure.hair.posing`), where no pose changes them.
"""

from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.head_frame import scalp_vertices
from quaffure.geometry.mls_kernels import LANES
from quaffure.hair.block_arrays import StrandBlocks
from quaffure.hair.groom import Groom
from quaffure.hair.posing import Ties, check_roots, rest_frames, rest_roots, ties_of
from quaffure.types import Float, Int, Tensor


class RestStrands(NamedTuple):
    """Strands in the frames in which they move rigidly.

    Attributes:
        edges: rest edges [m].
        offset: first vertex, from its position on its scalp triangle [m].
        corners: of the triangle, as indices of `scalp_vertices`.
        barycentric: position on the triangle.
        ties: with anchors as indices of `scalp_vertices`.
    """

    edges: Float[Tensor, "s e 3"]
    offset: Float[Tensor, "s 3"]
    corners: Int[Tensor, "s 3"]
    barycentric: Float[Tensor, "s 3"]
    ties: Ties


def rest_strands(groom: Groom, body: BodyModel) -> RestStrands:
    """A groom in the frames in which its strands move rigidly.

    Raises:
        InputError: roots that are not on the scalp of this body.
    """
    check_roots(groom, body)
    vertices = scalp_vertices(body)
    corners = torch.searchsorted(vertices, body.faces[groom.root_faces])
    ties = ties_of(groom, body)
    frames = rest_frames(groom, body, ties)
    offset = (groom.rest_strands[:, 0] - rest_roots(groom, body))[:, None] @ frames
    ties = ties._replace(anchor=torch.searchsorted(vertices, ties.anchor))
    edges = groom.rest_strands.diff(dim=1) @ frames
    return RestStrands(edges, offset[:, 0], corners, groom.root_barycentric, ties)


def strand_blocks(strands: RestStrands, margin: Float[Tensor, "s n"], order: Int[Tensor, " m"]) -> StrandBlocks:
    """Some strands in an order, near ones next to each other."""
    order = torch.cat([order, order[-1:].expand(-len(order) % LANES)])
    ties = strands.ties
    anchor = torch.full_like(strands.corners[:, 0], -1).index_copy(0, ties.strands, ties.anchor)
    of_ties = torch.cat([ties.offset, ties.direction], dim=1)
    tie = strands.offset.new_zeros(len(anchor), 6).index_copy(0, ties.strands, of_ties)
    edges, offset, corners, barycentric = (values[order] for values in strands[:4])
    parts = (edges, offset, corners.int(), barycentric, anchor[order].int(), tie[order], margin[order, 1:])
    return StrandBlocks(in_blocks(order.int()), *(in_blocks(values) for values in parts))


def in_blocks(values: Tensor) -> np.ndarray:
    """[strand, ...] to [block, ..., lane]."""
    return np.ascontiguousarray(values.detach().unflatten(0, (-1, LANES)).movedim(1, -1).numpy())
