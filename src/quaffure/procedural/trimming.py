"""Trimming: the length of every strand, and the surfaces at which strands are cut."""

import math

import torch

from quaffure.geometry.polyline import interpolate_vertices
from quaffure.hair.scalp_roots import ScalpRoots
from quaffure.procedural.hair_style import HairStyle
from quaffure.types import Bool, Float, Tensor

# The shortest hair: its edges are little longer than hair is thick [m].
SHORTEST = 0.004
# Width of the transition between a fringe and the hair next to it [m].
FRINGE_FADE = 0.008
# The region of the left ear without hair: an ellipsoid, its centre relative to the Head joint, and half axes [m].
EAR_CENTRE, EAR_AXES = (0.085, 0.002, 0.010), (0.022, 0.026, 0.044)


def strand_lengths(controls: HairStyle, roots: ScalpRoots, generator: torch.Generator) -> Float[Tensor, " s"]:
    """Length of each strand [m]: length map (forehead, crown, sides, nape), layers, clipped parts, variation."""
    u, v = roots.uv.unbind(1)
    aside = (2 * u - 1).abs().square()
    ahead = torch.cos(0.5 * math.pi * v.clamp(0, 1)).square()
    front, crown, side, nape = controls.length_map
    middle = 4 * v * (1 - v)
    ends = front * ahead + nape * (1 - ahead)
    factor = side * aside + (1 - aside) * (crown * middle + ends * (1 - middle))
    noise = controls.length_variation * (2 * torch.rand(len(roots), generator=generator) - 1)
    layer = controls.layering * torch.rand(len(roots), generator=generator) * root_heights(roots)
    lengths = controls.length * factor * (1 + noise) * (1 - layer)
    if controls.clipping is not None:
        very_short = controls.clipping.length * (1 + 0.15 * noise.sign())
        lengths = lengths + clipped_share(controls, roots) * (very_short - lengths)
    return lengths


def root_heights(roots: ScalpRoots) -> Float[Tensor, " s"]:
    """Height of the roots, from 0 at the lowest to 1 at the highest."""
    height = roots.points[:, 2]
    return (height - height.min()) / (height.max() - height.min())


def clipped_share(controls: HairStyle, roots: ScalpRoots) -> Float[Tensor, " s"]:
    """Share of clipping at each root: 1 in the clipped part, 0 outside, between the two in its fade."""
    clipping, clipped = controls.clipping, torch.zeros(len(roots))
    if clipping is None:
        return clipped
    x, _, z = roots.from_head.unbind(1)
    if clipping.below is not None:
        clipped = torch.maximum(clipped, ((clipping.below - z) / clipping.fade + 0.5).clamp(0, 1))
    if clipping.beyond is not None:
        clipped = torch.maximum(clipped, ((x.abs() - clipping.beyond) / clipping.fade + 0.5).clamp(0, 1))
    return clipped


def in_fringe(controls: HairStyle, roots: ScalpRoots, generator: torch.Generator) -> Bool[Tensor, " s"]:
    """Whether each strand belongs to the fringe, at random near the fringe's borders."""
    fringe = controls.fringe
    if fringe is None:
        return torch.zeros(len(roots), dtype=torch.bool)
    x, y, _ = roots.from_head.unbind(1)
    # The roots of a fringe cover a triangle: its base is the hairline, its apex points to the crown.
    behind = (y - y.min()) / fringe.depth
    noise = FRINGE_FADE * (torch.rand(len(roots), generator=generator) - 0.5)
    return (behind < 1) & ((x + noise).abs() < fringe.half_width * (1 - behind.clamp(min=0)).sqrt())


def trim_heights(
    controls: HairStyle, roots: ScalpRoots, fringe: Bool[Tensor, " s"], generator: torch.Generator
) -> Float[Tensor, " s"]:
    """World height below which each strand is cut [m]; -inf where it is not."""
    level = torch.full((len(roots),), -math.inf if controls.cut_height is None else controls.cut_height)
    rough = controls.length_variation * controls.length * (torch.rand(len(roots), generator=generator) - 0.5)
    if controls.fringe is not None:
        aside = roots.from_head[:, 0].square() / controls.fringe.half_width**2
        level = torch.where(fringe, controls.fringe.cut_height - controls.fringe.arch * aside, level)
    return level + rough + roots.head[2]


def trim_below(axes: Float[Tensor, "s n 3"], level: Float[Tensor, " s"]) -> Float[Tensor, "s n 3"]:
    """Strands cut at their first vertex below `level` [m, world], interpolated."""
    return trim_where(axes, level[:, None] - axes[..., 2])


def trim_above(axes: Float[Tensor, "s n 3"], height: float) -> Float[Tensor, "s n 3"]:
    """Strands cut at their first vertex above `height` [m, world], interpolated."""
    return trim_where(axes, axes[..., 2] - height)


def trim_around_ears(axes: Float[Tensor, "s n 3"], head: Float[Tensor, "3"]) -> Float[Tensor, "s n 3"]:
    """Strands cut where they first enter the region of an ear."""
    local = torch.cat([axes[..., :1].abs(), axes[..., 1:]], dim=-1) - head - torch.tensor(EAR_CENTRE)
    return trim_where(axes, 1 - (local / torch.tensor(EAR_AXES)).square().sum(-1))


def trim_where(axes: Float[Tensor, "s n 3"], depth: Float[Tensor, "s n"]) -> Float[Tensor, "s n 3"]:
    """Strands cut where `depth` first exceeds zero, resampled to the same number of vertices."""
    count = axes.shape[1]
    within = depth > 0
    cut = within.any(1)
    first = torch.where(cut, within.float().argmax(1), torch.full((len(axes),), count - 1)).clamp(min=1)
    before, after = (depth.gather(1, (first - back)[:, None])[:, 0] for back in (1, 0))
    last = first - torch.where(cut, after / (after - before).clamp(min=1e-6), 0.0).clamp(0, 1)
    shortest = (count - 1) * (SHORTEST / axes.diff(dim=1).norm(dim=-1).sum(1)).clamp(max=1)
    position = torch.linspace(0, 1, count) * last.maximum(shortest)[:, None]
    left = position.long().clamp(max=count - 2)
    return interpolate_vertices(axes, left, position - left)
