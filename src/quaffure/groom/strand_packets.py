"""A groom's rest strands in packets of sixteen neighbours, as compiled kernels read them.

A kernel works on a packet at once, a strand in each lane of the processor's vectors, and neighbours look at the same
skin. Edges are kept in the frame of the scalp triangle that carries the strand, where no pose changes them.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.head_view import scalp_vertices
from quaffure.errors import InputError
from quaffure.geometry.soft_surface import LANES
from quaffure.geometry.spread import neighbours_together
from quaffure.groom.groom import Groom
from quaffure.groom.pose_transform import root_positions, triangle_frames
from quaffure.types import Float, Int, Tensor

PER_LEADER = 8
"""Strands of which one, the leader, feels for all where the skin will push them."""


@dataclass(frozen=True, eq=False)
class StrandPackets:
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

    @cached_property
    def leaders(self) -> "StrandPackets":
        """The first of every `PER_LEADER` neighbours alone, in packets of their own."""
        return StrandPackets(*(_leading(getattr(self, field.name)) for field in fields(self)))


def strand_packets(groom: Groom, body: BodyModel, margin: Float[Tensor, "s n"]) -> StrandPackets:
    """Pack a groom.

    Args:
        margin: distance from the body that each vertex is to keep [m].

    Raises:
        InputError: a root that is not on the scalp.
    """
    corners = scalp_corners(groom, body)
    frames = triangle_frames(body.rest_vertices[body.faces[groom.root_faces]])
    offset = (groom.rest_strands[:, 0] - root_positions(groom, body.rest_vertices[None], body)[0])[:, None] @ frames
    order = _neighbours_together(groom)
    order = torch.cat([order, order[-1:].expand(-len(order) % LANES)])
    return StrandPackets(
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


def leader_of(groom: Groom) -> Int[Tensor, " s"]:
    """The leader of every strand; leaders lead themselves."""
    order = _neighbours_together(groom)
    leader = torch.empty_like(order)
    leader[order] = order[torch.arange(len(order), device=order.device) // PER_LEADER * PER_LEADER]
    return leader


def _leading(values: np.ndarray) -> np.ndarray:
    """Every `PER_LEADER`-th lane of [packet, ..., lane], packed anew."""
    rows = np.moveaxis(values, -1, 1).reshape(-1, *values.shape[1:-1])[::PER_LEADER]
    rows = np.concatenate([rows, np.repeat(rows[-1:], -len(rows) % LANES, axis=0)])
    return np.ascontiguousarray(np.moveaxis(rows.reshape(-1, LANES, *rows.shape[1:]), 1, -1))


def _packed(values: Tensor) -> np.ndarray:
    """[strand, ...] to [packet, ..., lane]."""
    return np.ascontiguousarray(values.detach().unflatten(0, (-1, LANES)).movedim(1, -1).numpy())


def _neighbours_together(groom: Groom) -> Int[Tensor, " s"]:
    """Order of strands in which those of a packet stay near each other."""
    root, middle, tip = (groom.rest_strands[:, vertex] for vertex in (0, groom.rest_strands.shape[1] // 2, -1))
    # The root counts most, for there the skin is.
    return neighbours_together(torch.cat([root, 0.5 * middle, 0.5 * tip], dim=1), LANES)
