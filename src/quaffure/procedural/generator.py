"""Procedural grooms: strands grown from the scalp along a styled direction field, on the mean body at rest."""

import torch

from quaffure.body.body_model import BodyModel
from quaffure.config import VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import CLEARANCE, pushed_out, rest_surface
from quaffure.hair.groom import Groom
from quaffure.hair.scalp_roots import ScalpRoots, spread_roots
from quaffure.hair.scalp_texture import select_guides
from quaffure.procedural.curls import arc_lengths, clumped, curl_arc_factor, curled
from quaffure.procedural.growth import course_of, grow
from quaffure.procedural.hair_style import STYLES, HairStyle
from quaffure.procedural.ties import bundle_of, gather, gathered_by
from quaffure.procedural.trimming import (
    SHORTEST,
    cut_above,
    cut_below,
    cut_levels,
    cut_off_ears,
    in_fringe,
    strand_lengths,
)
from quaffure.types import Float, Tensor

LICENCE = "Apache-2.0 (procedural, part of quaffure)"
# Steps of the growth for each edge of the groom.
STEPS_PER_EDGE = 2
STEPS = STEPS_PER_EDGE * (VERTICES_PER_STRAND - 1)
# At least this many edges of a gathered strand lie on either side of its band.
LEAST_EDGES = 3


def make_groom(style: str | HairStyle, body: BodyModel, seed: int = 0, surface: Surface | None = None) -> Groom:
    """A groom in a style: the same for the same style, body and seed, on any machine of one kind.

    Args:
        style: a name in `STYLES`, or controls.
        surface: of the body at rest, when at hand (`rest_surface`).

    Raises:
        InputError: no style of that name.
    """
    name, controls = _controls(style)
    surface = surface or rest_surface(body)
    generator = torch.Generator().manual_seed(seed)
    roots = spread_roots(body, controls.root_rows, generator)
    axes, tied = _axes(controls, roots, body, surface, generator)
    axes = clumped(controls, axes, tied)
    strands = evenly(curled(controls, axes, roots.normals, tied, generator), tied)
    strands = pushed_out(strands, surface, CLEARANCE)
    strands[:, 0] = roots.points
    # Rounding can move a root across a texel's border, to where another one is.
    return select_guides(Groom(name, strands, roots.faces, roots.barycentric, roots.uv, LICENCE))


def _controls(style: str | HairStyle) -> tuple[str, HairStyle]:
    if isinstance(style, HairStyle):
        return "procedural", style
    if style not in STYLES:
        raise InputError("style", f"one of {', '.join(sorted(STYLES))}", repr(style))
    return style, STYLES[style]


def _axes(
    controls: HairStyle, roots: ScalpRoots, body: BodyModel, surface: Surface, generator: torch.Generator
) -> tuple[Float[Tensor, "s n 3"], Float[Tensor, " s"]]:
    """Axes of free and of gathered strands, and the length after which each is free [m]."""
    axes, tied = torch.empty(len(roots), STEPS + 1, 3), torch.zeros(len(roots))
    band = gathered_by(controls, roots)
    free = torch.nonzero(band < 0)[:, 0]
    if len(free):
        axes[free] = _free_axes(controls, roots.select(free), body, surface, generator)
    for index, tie in enumerate(controls.ties):
        own = torch.nonzero(band == index)[:, 0]
        bundle = bundle_of(tie, roots.select(own), body, generator)
        axes[own], in_band = gather(controls, tie, bundle, STEPS, surface, generator)
        tied[own] = arc_lengths(axes[own])[:, in_band]
    return axes, tied


def _free_axes(
    controls: HairStyle, roots: ScalpRoots, body: BodyModel, surface: Surface, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    fringe = in_fringe(controls, roots, generator)
    lengths = (strand_lengths(controls, roots, generator) / curl_arc_factor(controls)).clamp(min=SHORTEST)
    course = course_of(controls, roots, fringe, lengths, STEPS, body, generator)
    axes = grow(course, controls, STEPS, roots.head, surface)
    axes = cut_below(axes, cut_levels(controls, roots, fringe, generator))
    if controls.flat_top is not None:
        axes = cut_above(axes, controls.flat_top + float(roots.head[2]))
    return cut_off_ears(axes, roots.head) if controls.cut_around_ears else axes


def evenly(fine: Float[Tensor, "s n 3"], tied: Float[Tensor, " s"]) -> Float[Tensor, "s m 3"]:
    """Strands of `VERTICES_PER_STRAND` vertices at even distances; a gathered one has a vertex in its band."""
    edges = VERTICES_PER_STRAND - 1
    reach = arc_lengths(fine)
    # A curl makes its strand longer than the axis along which the band was placed, but not before the band.
    before = (edges * tied / reach[:, -1].clamp(min=1e-6)).round().clamp(LEAST_EDGES, edges - LEAST_EDGES)
    before = torch.where(tied > 0, before, 0.0)[:, None]
    index = torch.arange(VERTICES_PER_STRAND)
    first = tied[:, None] * index / before.clamp(min=1)
    rest = tied[:, None] + (reach[:, -1:] - tied[:, None]) * (index - before) / (edges - before)
    place = torch.where(index <= before, first, rest)
    place = torch.where(before > 0, place, reach[:, -1:] * index / edges)
    right = torch.searchsorted(reach, place).clamp(1, fine.shape[1] - 1)
    start, end = (reach.gather(1, right - back) for back in (1, 0))
    weight = ((place - start) / (end - start).clamp(min=1e-9)).clamp(0, 1)[..., None]
    left, beyond = (fine.gather(1, (right - back)[..., None].expand(-1, -1, 3)) for back in (1, 0))
    return (1 - weight) * left + weight * beyond
