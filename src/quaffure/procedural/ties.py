"""Tied hair: along the scalp to a band, through it, and beyond it as a tail, a puff or a bun."""

import math
from dataclasses import dataclass

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import CLEARANCE, CLEARANCE_RAMP, distances_and_normals
from quaffure.hair.scalp_roots import ScalpRoots, roots_at
from quaffure.procedural.hair_style import HairStyle, Tie
from quaffure.procedural.strand_tracing import TraceInputs, out_of_ears, smoothed, trace_strands
from quaffure.types import Float, Int, Tensor

# Hair lies on the hair below it: the layer reaches its thickness over this length along the scalp [m].
LAYER_LENGTH = 0.15
# Hair with its root next to the ear is clear of it after this length [m].
LIFT_LENGTH = 0.04
# Slope of the lower limit of tied hair: lower at the temples, higher on the back of the head.
LIMIT_SLOPE = 0.5
# A hanging tail widens by this share of the fan in which it leaves the band.
TAIL_FAN = 0.1
# A band further from the mid-plane than this holds a pigtail, which falls before the shoulder [m].
PIGTAIL = 0.03
# A bun is a ball of hair: strands lie between this share of its radius and all of it.
BUN_CORE = 0.6
# Distance of its centre from the band, relative to its radius.
BUN_RISE = 0.55
# Polar angle at which a strand in the bun ends [rad], and share of its length that rises through the core.
BUN_RIM, BUN_CORE_SHARE = 1.9, 0.15


@dataclass(frozen=True)
class StrandBundle:
    """Strands that pass through one band.

    Attributes:
        roots: of the strands.
        axis: unit direction in which the tail leaves the band.
        centre: of the band [m].
        radial: unit direction across the axis from the centre to each strand.
        share: distance of each strand from the centre, relative to the band's radius.
        crossings: points in which the strands cross the band [m].
    """

    roots: ScalpRoots
    axis: Float[Tensor, "3"]
    centre: Float[Tensor, "3"]
    radial: Float[Tensor, "s 3"]
    share: Float[Tensor, " s"]
    crossings: Float[Tensor, "s 3"]


def tie_of_strand(controls: HairStyle, roots: ScalpRoots) -> Int[Tensor, " s"]:
    """Index of the tie of each strand, -1 for free hair."""
    chosen = torch.full((len(roots),), -1)
    x, y, z = roots.from_head.unbind(1)
    height = z - LIMIT_SLOPE * y
    for index, tie in enumerate(controls.ties):
        own = (x * tie.side >= 0) & (height >= (-math.inf if tie.gathers_above is None else tie.gathers_above))
        chosen = torch.where((chosen < 0) & own, index, chosen)
    return chosen


def strand_bundle(tie: Tie, roots: ScalpRoots, body: BodyModel, generator: torch.Generator) -> StrandBundle:
    """Strands cross the band on the side of their roots, so that they do not intersect in it."""
    below = roots_at(body, torch.tensor([tie.place]))
    axis = normalize(below.normals[0] + tie.upwards * torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    centre = below.points[0] + tie.stand_off * below.normals[0]
    offset = roots.points - centre
    radial = normalize(offset - (offset @ axis)[:, None] * axis, dim=-1)
    share = torch.rand(len(roots), generator=generator).sqrt()
    return StrandBundle(roots, axis, centre, radial, share, centre + tie.radius * share[:, None] * radial)


def trace_tied(
    controls: HairStyle, tie: Tie, bundle: StrandBundle, steps: int, surface: Surface, generator: torch.Generator
) -> tuple[Float[Tensor, "s n 3"], int]:
    """Axes of `steps` steps, and the index of their vertex in the band."""
    to_band = steps // 2
    first = _to_band(controls, bundle, to_band, surface, generator)
    if tie.bun_radius is None:
        rest = _tail(controls, tie, bundle, steps - to_band, surface, generator)
    else:
        rest = _bun(tie, bundle, tie.bun_radius, steps - to_band, generator)
    return torch.cat([first, rest[:, 1:]], dim=1), to_band


def _to_band(
    controls: HairStyle, bundle: StrandBundle, steps: int, surface: Surface, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    """From the roots to the band: straight, but outside of the head; nearly a geodesic."""
    point = bundle.roots.points
    length = torch.zeros(len(point))
    thickness = controls.layer_thickness * (0.3 + 0.7 * torch.rand(len(point), generator=generator))
    points = [point]
    for index in range(steps):
        moved = point + (bundle.crossings - point) / (steps - index)
        distance, normal = distances_and_normals(moved, surface)
        clearance = CLEARANCE + thickness * (length / LAYER_LENGTH).clamp(max=1)
        lowest = torch.minimum(clearance, CLEARANCE_RAMP * (length + CLEARANCE))
        moved = moved + (lowest - distance).clamp(min=0)[:, None] * normal
        moved = out_of_ears(moved, bundle.roots.head, (length / LIFT_LENGTH).clamp(max=1), held=True)
        length = length + (moved - point).norm(dim=-1)
        point = moved
        points.append(point)
    points[-1] = bundle.crossings
    return smoothed(torch.stack(points, dim=1))


def _tail(
    controls: HairStyle, tie: Tie, bundle: StrandBundle, steps: int, surface: Surface, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    """Beyond the band as free hair, fanned out."""
    strands = len(bundle.share)
    angle = math.radians(tie.spread_deg) * bundle.share[:, None]
    noise = 2 * torch.rand(strands, generator=generator) - 1
    pigtail = bool(bundle.centre[0].abs() > PIGTAIL)
    down = torch.tensor([0.0, 0.0, -1.0])
    inputs = TraceInputs(
        start=bundle.crossings,
        root_direction=torch.cos(angle) * bundle.axis + torch.sin(angle) * bundle.radial,
        hanging_direction=normalize(down + TAIL_FAN * torch.sin(angle) * bundle.radial, dim=-1),
        step=tie.tail_length * (1 + controls.length_variation * noise) / steps,
        clearance=CLEARANCE + controls.layer_thickness * torch.rand(strands, generator=generator),
        face_side=torch.where(bundle.crossings[:, 0] >= 0, 1.0, -1.0),
        shoulder_line=torch.full((strands,), math.inf if pigtail else -math.inf),
        face_opening=torch.full((strands,), controls.face_opening),
    )
    return trace_strands(inputs, controls, steps, bundle.roots.head, surface)


def _bun(
    tie: Tie, bundle: StrandBundle, radius: float, steps: int, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    """Beyond the band up through the core of a ball and down around it as a spiral to its rim."""
    core = BUN_CORE + (1 - BUN_CORE) * torch.rand(len(bundle.share), generator=generator).sqrt()
    centre = bundle.centre + BUN_RISE * radius * bundle.axis
    share = torch.linspace(0, 1, steps + 1)
    wound = ((share - BUN_CORE_SHARE) / (1 - BUN_CORE_SHARE)).clamp(min=0)
    end = 1 + 0.2 * (torch.rand(len(bundle.share), 1, generator=generator) - 0.5)
    polar = BUN_RIM * (wound * end)[..., None]
    azimuth = 2 * math.pi * tie.turns * (wound * end)[..., None]
    across = torch.linalg.cross(bundle.axis.expand_as(bundle.radial), bundle.radial)
    around = torch.cos(azimuth) * bundle.radial[:, None] + torch.sin(azimuth) * across[:, None]
    ball = centre + radius * core[:, None, None] * (torch.cos(polar) * bundle.axis + torch.sin(polar) * around)
    rise = (share / BUN_CORE_SHARE).clamp(max=1)[:, None]
    start = bundle.crossings[:, None]
    return smoothed(torch.cat([start, (start + rise * (ball - start))[:, 1:]], 1))
