"""Hair gathered into ties: along the scalp to a band, through it, and on as a tail, a puff or a bun."""

import math
from dataclasses import dataclass

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import CLEARANCE, CLEARANCE_RAMP, distances_and_normals
from quaffure.hair.scalp_roots import ScalpRoots, roots_at
from quaffure.procedural.growth import Course, grow, round_ears, smoothed
from quaffure.procedural.hair_style import HairStyle, Tie
from quaffure.types import Float, Int, Tensor

# Hair lies on the hair that it passes: the layer reaches its thickness over this way along the scalp [m].
LAYER_WAY = 0.15
# Hair that roots beside the ear passes clear of it after this way [m].
LIFT_WAY = 0.04
# What is gathered from above a height is more on the temples, less on the back of the head, by this slope.
GATHER_SLOPE = 0.5
# A tail widens where it falls, by this share of the fan in which it leaves the band.
TAIL_FAN = 0.1
# A band further aside than this holds a pigtail, which falls before the shoulder [m].
PIGTAIL = 0.03
# A bun is a ball of hair: strands lie between this share of its radius and all of it.
BUN_CORE = 0.6
# Its middle lies this share of its radius beyond the band.
BUN_RISE = 0.55
# A strand winds from the bun's pole to this angle from it [radians], after it has risen through its core.
BUN_RIM, BUN_CORE_SHARE = 1.9, 0.15


@dataclass(frozen=True)
class Bundle:
    """Strands on their way through one band.

    Attributes:
        roots: where they grow.
        axis: unit direction in which the tail leaves the band.
        middle: of the band [m].
        spoke: unit direction across the axis from the middle to each strand.
        share: distance of each strand from the middle, relative to the band's radius.
        ring: where each strand passes the band [m].
    """

    roots: ScalpRoots
    axis: Float[Tensor, "3"]
    middle: Float[Tensor, "3"]
    spoke: Float[Tensor, "s 3"]
    share: Float[Tensor, " s"]
    ring: Float[Tensor, "s 3"]


def gathered_by(controls: HairStyle, roots: ScalpRoots) -> Int[Tensor, " s"]:
    """The tie that each strand goes to, -1 for free hair."""
    chosen = torch.full((len(roots),), -1)
    x, y, z = roots.from_head.unbind(1)
    height = z - GATHER_SLOPE * y
    for index, tie in enumerate(controls.ties):
        own = (x * tie.side >= 0) & (height >= (-math.inf if tie.gathers_above is None else tie.gathers_above))
        chosen = torch.where((chosen < 0) & own, index, chosen)
    return chosen


def bundle_of(tie: Tie, roots: ScalpRoots, body: BodyModel, generator: torch.Generator) -> Bundle:
    """Strands enter the band from the side that they come from, so that they do not cross in it."""
    below = roots_at(body, torch.tensor([tie.place]))
    axis = normalize(below.normals[0] + tie.upwards * torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    middle = below.points[0] + tie.stand_off * below.normals[0]
    away = roots.points - middle
    spoke = normalize(away - (away @ axis)[:, None] * axis, dim=-1)
    share = torch.rand(len(roots), generator=generator).sqrt()
    return Bundle(roots, axis, middle, spoke, share, middle + tie.radius * share[:, None] * spoke)


def gather(
    controls: HairStyle, tie: Tie, bundle: Bundle, steps: int, surface: Surface, generator: torch.Generator
) -> tuple[Float[Tensor, "s n 3"], int]:
    """Axes of `steps` steps, and which of their vertices lies in the band."""
    to_band = steps // 2
    drawn = _drawn(controls, bundle, to_band, surface, generator)
    if tie.bun_radius is None:
        tail = _fallen(controls, tie, bundle, steps - to_band, surface, generator)
    else:
        tail = _wound(tie, bundle, steps - to_band, generator)
    return torch.cat([drawn, tail[:, 1:]], dim=1), to_band


def _drawn(
    controls: HairStyle, bundle: Bundle, steps: int, surface: Surface, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    """From the roots to the band: straight ahead, but over the head; nearly a geodesic."""
    point = bundle.roots.points
    travelled = torch.zeros(len(point))
    thickness = controls.layer_thickness * (0.3 + 0.7 * torch.rand(len(point), generator=generator))
    points = [point]
    for index in range(steps):
        wanted = point + (bundle.ring - point) / (steps - index)
        distance, normal = distances_and_normals(wanted, surface)
        clearance = CLEARANCE + thickness * (travelled / LAYER_WAY).clamp(max=1)
        lowest = torch.minimum(clearance, CLEARANCE_RAMP * (travelled + CLEARANCE))
        wanted = wanted + (lowest - distance).clamp(min=0)[:, None] * normal
        wanted = round_ears(wanted, bundle.roots.head, (travelled / LIFT_WAY).clamp(max=1), held=True)
        travelled = travelled + (wanted - point).norm(dim=-1)
        point = wanted
        points.append(point)
    points[-1] = bundle.ring
    return smoothed(torch.stack(points, dim=1))


def _fallen(
    controls: HairStyle, tie: Tie, bundle: Bundle, steps: int, surface: Surface, generator: torch.Generator
) -> Float[Tensor, "s n 3"]:
    """Beyond the band as free hair, fanned out."""
    strands = len(bundle.share)
    angle = math.radians(tie.spread_deg) * bundle.share[:, None]
    noise = 2 * torch.rand(strands, generator=generator) - 1
    pigtail = bool(bundle.middle[0].abs() > PIGTAIL)
    down = torch.tensor([0.0, 0.0, -1.0])
    course = Course(
        start=bundle.ring,
        heading=torch.cos(angle) * bundle.axis + torch.sin(angle) * bundle.spoke,
        falling=normalize(down + TAIL_FAN * torch.sin(angle) * bundle.spoke, dim=-1),
        step=tie.tail_length * (1 + controls.length_variation * noise) / steps,
        clearance=CLEARANCE + controls.layer_thickness * torch.rand(strands, generator=generator),
        aside=torch.where(bundle.ring[:, 0] >= 0, 1.0, -1.0),
        line=torch.full((strands,), math.inf if pigtail else -math.inf),
        opening=torch.full((strands,), controls.face_opening),
    )
    return grow(course, controls, steps, bundle.roots.head, surface)


def _wound(tie: Tie, bundle: Bundle, steps: int, generator: torch.Generator) -> Float[Tensor, "s n 3"]:
    """Beyond the band up through the middle of a ball and round it, down to its rim."""
    assert tie.bun_radius is not None
    core = BUN_CORE + (1 - BUN_CORE) * torch.rand(len(bundle.share), generator=generator).sqrt()
    radius = tie.bun_radius * core[:, None, None]
    centre = bundle.middle + BUN_RISE * tie.bun_radius * bundle.axis
    share = torch.linspace(0, 1, steps + 1)
    wound = ((share - BUN_CORE_SHARE) / (1 - BUN_CORE_SHARE)).clamp(min=0)
    end = 1 + 0.2 * (torch.rand(len(bundle.share), 1, generator=generator) - 0.5)
    pole = BUN_RIM * (wound * end)[..., None]
    turn = 2 * math.pi * tie.turns * (wound * end)[..., None]
    across = torch.linalg.cross(bundle.axis.expand_as(bundle.spoke), bundle.spoke)
    around = torch.cos(turn) * bundle.spoke[:, None] + torch.sin(turn) * across[:, None]
    ball = centre + radius * (torch.cos(pole) * bundle.axis + torch.sin(pole) * around)
    rise = (share / BUN_CORE_SHARE).clamp(max=1)[:, None]
    return smoothed(
        torch.cat([bundle.ring[:, None], (bundle.ring[:, None] + rise * (ball - bundle.ring[:, None]))[:, 1:]], 1)
    )
