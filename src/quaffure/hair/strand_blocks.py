"""A groom's rest strands in packets of sixteen neighbours, as compiled kernels read them.

A kernel works on a packet at once, a strand in each lane of the processor's vectors, and neighbours look at the same
skin. Edges are kept in the frame of the scalp triangle that carries the strand, where no pose changes them.
"""

from dataclasses import dataclass

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.head_frame import scalp_vertices
from quaffure.errors import InputError
from quaffure.geometry.mls_surface import LANES
from quaffure.geometry.sampling import neighbours_together
from quaffure.hair.groom import Groom
from quaffure.hair.posing import root_positions, triangle_frames
from quaffure.types import Float, Int, Tensor

CLUSTER_SIZE, CLUSTER_RADIUS = 8, 0.02
"""Strands of which one, the leader, feels for all where the skin will push them, and how far from its root they may
root at most [m]; strands further away lead themselves."""


@dataclass(frozen=True, eq=False)
class StrandBlocks:
    """The last packet repeats the last strand where the groom does not fill it.

    Attributes:
        strand: which strand of the groom each lane holds.
        edges: rest edges in the frame of the strand's scalp triangle [m].
        offset: of the first vertex from the place on the triangle, in its frame [m].
        corners: of the triangle, as indices of `scalp_vertices`.
        barycentric: of the place on the triangle.
        margin: distance from the body that the far vertex of each edge is to keep [m].
    """

    strand: Int[np.ndarray, "packet lane"]
    edges: Float[np.ndarray, "packet e 3 lane"]
    offset: Float[np.ndarray, "packet 3 lane"]
    corners: Int[np.ndarray, "packet 3 lane"]
    barycentric: Float[np.ndarray, "packet 3 lane"]
    margin: Float[np.ndarray, "packet e lane"]


@dataclass(frozen=True, eq=False)
class ClusteredBlocks(StrandBlocks):
    """All strands of a groom, and those that lead them once more in packets of their own.

    Attributes:
        leading: the leaders alone.
        leader: place among their lanes of the one that leads each strand.
        strands: how many there are.
    """

    leading: StrandBlocks
    leader: Int[np.ndarray, "packet lane"]
    strands: int


def strand_blocks(groom: Groom, body: BodyModel, margin: Float[Tensor, "s n"]) -> ClusteredBlocks:
    """Pack a groom.

    Args:
        margin: distance from the body that each vertex is to keep [m].

    Raises:
        InputError: a root that is not on the scalp.
    """
    order, leader = _led_order(groom)
    leading = order[leader[order] == order]
    lane_of = torch.empty_like(order)
    lane_of[leading] = torch.arange(len(leading), device=order.device)
    whole = _whole_packets(order)
    packets, led = (_packets(groom, body, margin, chosen) for chosen in (whole, _whole_packets(leading)))
    return ClusteredBlocks(
        **vars(packets), leading=led, leader=_packed(lane_of[leader[whole]].int()), strands=len(groom)
    )


def _packets(groom: Groom, body: BodyModel, margin: Float[Tensor, "s n"], order: Int[Tensor, " lanes"]) -> StrandBlocks:
    corners = scalp_corners(groom, body)
    frames = triangle_frames(body.rest_vertices[body.faces[groom.root_faces]])
    offset = (groom.rest_strands[:, 0] - root_positions(groom, body.rest_vertices[None], body)[0])[:, None] @ frames
    return StrandBlocks(
        _packed(order.int()),
        _packed((groom.rest_strands.diff(dim=1) @ frames)[order]),
        _packed(offset[order, 0]),
        _packed(corners[order].int()),
        _packed(groom.root_barycentric[order]),
        _packed(margin[order, 1:]),
    )


def scalp_corners(groom: Groom, body: BodyModel) -> Int[Tensor, "s 3"]:
    """Corners of the triangles that carry the roots, as indices of `scalp_vertices`.

    Raises:
        InputError: a root that is not on the scalp.
    """
    carriers, vertices = body.faces[groom.root_faces], scalp_vertices(body)
    corners = torch.searchsorted(vertices, carriers).clamp(max=len(vertices) - 1)
    if not torch.equal(vertices[corners], carriers):
        raise InputError(groom.name, "roots on the scalp", "roots elsewhere")
    return corners


def cluster_representatives(groom: Groom) -> Int[Tensor, " s"]:
    """The strand that feels for each: of `CLUSTER_SIZE` neighbours the one in their middle, which leads itself."""
    return _led_order(groom)[1]


def _led_order(groom: Groom) -> tuple[Int[Tensor, " s"], Int[Tensor, " s"]]:
    """Order of strands in which every `CLUSTER_SIZE` are neighbours, and the leader of each strand."""
    places, root = _places(groom), groom.rest_strands[:, 0]
    order = neighbours_together(places, CLUSTER_SIZE)
    groups = torch.cat([order, order[-1:].expand(-len(order) % CLUSTER_SIZE)]).view(-1, CLUSTER_SIZE)
    off = (places[groups] - places[groups].mean(dim=1, keepdim=True)).square().sum(-1)
    leader = torch.empty_like(order)
    leader[groups] = groups.gather(1, off.argmin(dim=1, keepdim=True)).expand_as(groups)
    own = torch.arange(len(order), device=order.device)
    return order, torch.where((root - root[leader]).norm(dim=-1) < CLUSTER_RADIUS, leader, own)


def _whole_packets(order: Int[Tensor, " m"]) -> Int[Tensor, " lanes"]:
    return torch.cat([order, order[-1:].expand(-len(order) % LANES)])


def _packed(values: Tensor) -> np.ndarray:
    """[strand, ...] to [packet, ..., lane]."""
    return np.ascontiguousarray(values.detach().unflatten(0, (-1, LANES)).movedim(1, -1).numpy())


def _places(groom: Groom) -> Float[Tensor, "s 9"]:
    """Where strands are; those of near places are neighbours."""
    root, middle, tip = (groom.rest_strands[:, vertex] for vertex in (0, groom.rest_strands.shape[1] // 2, -1))
    # The root counts most, for there the skin is.
    return torch.cat([root, 0.5 * middle, 0.5 * tip], dim=1)
