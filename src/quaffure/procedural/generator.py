"""Procedural grooms: strands traced from the scalp along a styled orientation field, on the mean body at rest."""

import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.config import VERTICES_PER_STRAND
from quaffure.energies.held_parts import with_ties
from quaffure.errors import InputError
from quaffure.geometry.polyline import arc_lengths, points_along
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import pushed_out
from quaffure.hair.folds import without_folds
from quaffure.hair.groom import Groom
from quaffure.hair.groom_transfer import transfer_groom
from quaffure.hair.scalp_roots import ScalpRoots, spread_roots
from quaffure.hair.scalp_texture import select_guides
from quaffure.procedural import trimming
from quaffure.procedural.curls import clumped, curl_arc_factor, curled
from quaffure.procedural.hair_style import STYLES, HairStyle
from quaffure.procedural.strand_tracing import free_hair_inputs, trace_strands
from quaffure.procedural.ties import strand_bundle, tie_of_strand, trace_tied
from quaffure.types import Float, Int, Tensor

LICENCE = "Apache-2.0 (procedural, part of quaffure)"
# Steps of the tracing for each edge of the groom.
STEPS_PER_EDGE = 2
STEPS = STEPS_PER_EDGE * (VERTICES_PER_STRAND - 1)
# At least this many edges of a tied strand lie on either side of its band.
LEAST_EDGES = 3


def make_groom(style: str | HairStyle, body: BodyModel, seed: int = 0) -> Groom:
    """A groom in a style: the same for the same style, body and seed, on machines of one kind.

    Args:
        style: a name in `STYLES`, or controls.
        body: for that of a character the groom is made on the shipped one and transferred: styles are sizes and places
            on that head, and would be other styles on another.

    Raises:
        InputError: no style of that name.
    """
    if isinstance(style, str) and style not in STYLES:
        raise InputError("style", f"one of {', '.join(sorted(STYLES))}", repr(style))
    if body.origin is not None:
        return transfer_groom(make_groom(style, load_body(), seed), load_body(), body)
    name, controls = (style, STYLES[style]) if isinstance(style, str) else ("procedural", style)
    surface, generator = body.rest_surface, torch.Generator().manual_seed(seed)
    roots = spread_roots(body, controls.root_rows, generator)
    axes, tied = _axes(controls, roots, body, surface, generator)
    axes = clumped(controls, axes, tied)
    fine = curled(controls, axes, roots.normals, tied, generator)
    in_band = vertex_in_band(fine, tied)
    strands = pushed_out(resample_evenly(fine, tied, in_band), surface)
    strands[:, 0] = roots.points
    groom = Groom(name, without_folds(strands), roots.faces, roots.barycentric, roots.uv, LICENCE)
    if controls.ties:
        groom = with_ties(groom, _tie_vertices(controls, tie_of_strand(controls, roots), in_band))
    # Rounding can move a root across a texel's border, to where another one is.
    return select_guides(groom)


def _axes(
    controls: HairStyle, roots: ScalpRoots, body: BodyModel, surface: Surface, generator: torch.Generator
) -> tuple[Float[Tensor, "s n 3"], Float[Tensor, " s"]]:
    """Axes of free and of tied strands, and the length from the root to the band, zero for free ones [m]."""
    axes, tied = torch.empty(len(roots), STEPS + 1, 3), torch.zeros(len(roots))
    tie_index = tie_of_strand(controls, roots)
    free = torch.nonzero(tie_index < 0)[:, 0]
    if len(free):
        axes[free] = _free_axes(controls, roots.select(free), body, surface, generator)
    for index, tie in enumerate(controls.ties):
        own = torch.nonzero(tie_index == index)[:, 0]
        bundle = strand_bundle(tie, roots.select(own), body, generator)
        axes[own], in_band = trace_tied(controls, tie, bundle, STEPS, surface, generator)
        tied[own] = arc_lengths(axes[own])[:, in_band]
    return axes, tied


def _free_axes(
    controls: HairStyle, roots: ScalpRoots, body: BodyModel, surface: Surface, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    fringe = trimming.in_fringe(controls, roots, generator)
    lengths = trimming.strand_lengths(controls, roots, generator) / curl_arc_factor(controls)
    lengths = lengths.clamp(min=trimming.SHORTEST)
    inputs = free_hair_inputs(controls, roots, fringe, lengths, STEPS, body, generator)
    axes = trace_strands(inputs, controls, STEPS, roots.head, surface)
    axes = trimming.trim_below(axes, trimming.trim_heights(controls, roots, fringe, generator))
    if controls.flat_top is not None:
        axes = trimming.trim_above(axes, controls.flat_top + float(roots.head[2]))
    return trimming.trim_around_ears(axes, roots.head) if controls.cut_around_ears else axes


def _tie_vertices(controls: HairStyle, tie_index: Int[Tensor, " s"], in_band: Int[Tensor, " s"]) -> Int[Tensor, " s"]:
    """Vertex up to which each strand is held, -1 for free ones: in the band, or the tip of a strand in a bun."""
    in_bun = torch.tensor([tie.bun_radius is not None for tie in controls.ties])
    held_to = torch.where(in_bun[tie_index.clamp(min=0)], VERTICES_PER_STRAND - 1, in_band)
    return torch.where(tie_index >= 0, held_to, -1)


def vertex_in_band(fine: Float[Tensor, "s n 3"], tied: Float[Tensor, " s"]) -> Int[Tensor, " s"]:
    """Which of its `VERTICES_PER_STRAND` vertices a strand has in its band, 0 for free strands."""
    edges = VERTICES_PER_STRAND - 1
    # A curl makes its strand longer than the axis along which the band was placed, but not before the band.
    before = (edges * tied / arc_lengths(fine)[:, -1].clamp(min=1e-6)).round().clamp(LEAST_EDGES, edges - LEAST_EDGES)
    return torch.where(tied > 0, before, 0.0).long()


def resample_evenly(
    fine: Float[Tensor, "s n 3"], tied: Float[Tensor, " s"], in_band: Int[Tensor, " s"]
) -> Float[Tensor, "s m 3"]:
    """Strands of `VERTICES_PER_STRAND` vertices at even distances; a tied one has its vertex `in_band` there."""
    edges = VERTICES_PER_STRAND - 1
    length = arc_lengths(fine)
    before = in_band[:, None]
    index = torch.arange(VERTICES_PER_STRAND)
    first = tied[:, None] * index / before.clamp(min=1)
    rest = tied[:, None] + (length[:, -1:] - tied[:, None]) * (index - before) / (edges - before)
    position = torch.where(index <= before, first, rest)
    position = torch.where(before > 0, position, length[:, -1:] * index / edges)
    return points_along(fine, position)
