"""Where hair is combed: the direction of growth at every root, and the way that loose hair falls."""

import math

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.hair.scalp_roots import ScalpRoots, roots_at
from quaffure.procedural.hair_style import HairStyle
from quaffure.procedural.trimming import clipped_share
from quaffure.types import Bool, Float, Tensor

# The parting ends this far before the crown, and fades out over this distance [m].
PARTING_END, PARTING_FADE = 0.015, 0.012
# Beside the parting and round the crown hair lies flat: of its lift this share is left there, over this distance [m].
FLAT_LIFT, FLAT_REACH = 0.3, 0.04
# Hair that grows behind this line, seen from the Head joint, falls backwards, the rest forwards; it fades over [m].
FALL_LINE, FALL_FADE = -0.005, 0.02
# Hair before the shoulders hangs steeper than hair behind them.
FORWARDS = 0.15
# Loose hair draws in towards the neck by this slope.
INWARDS = 0.1
# Where the crown is, between the forehead's and the nape's rim of the chart.
CROWN_V = 0.47
# Clipped hair leans on the scalp by this angle [degrees].
CLIPPED_LIFT_DEG = 35.0
# A fringe leaves the scalp flatter than the rest.
FRINGE_LIFT = 0.5


def growth_directions(
    controls: HairStyle,
    roots: ScalpRoots,
    fringe: Bool[Tensor, " s"],
    body: BodyModel,
    generator: torch.Generator,
) -> Float[Tensor, "s 3"]:
    """Unit directions of growth: combed tangents, lifted off the scalp."""
    tangents = torch.where(fringe[:, None], _fringe_tangents(controls, roots), growth_tangents(controls, roots, body))
    lift = torch.full((len(roots),), math.radians(controls.lift_deg))
    # Hair that stands up anyway hides where it divides.
    lift = lift * (1 - (1 - FLAT_LIFT) * torch.cos(lift) * _where_hair_divides(controls, roots, body))
    clipped = clipped_share(controls, roots)
    lift = torch.where(fringe, FRINGE_LIFT * lift, lift)
    lift = (lift + clipped * (math.radians(CLIPPED_LIFT_DEG) - lift))[:, None]
    directions = torch.cos(lift) * tangents + torch.sin(lift) * roots.normals
    noise = math.radians(controls.direction_variation_deg) * torch.randn(directions.shape, generator=generator)
    return normalize(directions + noise, dim=-1)


def _where_hair_divides(controls: HairStyle, roots: ScalpRoots, body: BodyModel) -> Float[Tensor, " s"]:
    """1 on the parting and on the crown that hair grows away from, fading to 0 beside them."""
    divides = torch.zeros(len(roots))
    if controls.parting is not None and controls.from_parting > 0:
        aside = (roots.points[:, 0] - controls.parting) / FLAT_REACH
        divides = _on_parting(controls, roots, body) * torch.exp(-aside.square())
    if controls.from_crown > 0:
        from_crown = (roots.points - _crown(body)).norm(dim=1) / FLAT_REACH
        divides = torch.maximum(divides, torch.exp(-from_crown.square()))
    return divides


def growth_tangents(controls: HairStyle, roots: ScalpRoots, body: BodyModel) -> Float[Tensor, "s 3"]:
    """Unit directions of growth in the scalp's tangent planes."""
    # The parting runs into the crown; between the two, hair would grow both ways at once.
    crown = _crown(body) + torch.tensor([controls.parting or 0.0, 0.0, 0.0])
    outwards = normalize(along_scalp(roots.points - crown, roots.normals), dim=-1)
    field = controls.from_crown * outwards + controls.whorl * torch.linalg.cross(roots.normals, outwards)
    field = field + controls.backwards * torch.tensor([0.0, 1.0, -0.5])
    field = field + controls.sideways * torch.tensor([1.0, 0.0, 0.0])
    if controls.parting is not None:
        to_side = torch.where(roots.points[:, :1] >= controls.parting, 1.0, -1.0) * torch.tensor([1.0, 0.0, -0.2])
        field = field + controls.from_parting * _on_parting(controls, roots, body)[:, None] * to_side
    return normalize(along_scalp(field, roots.normals), dim=-1)


def _crown(body: BodyModel) -> Float[Tensor, "3"]:
    return roots_at(body, torch.tensor([[0.5, CROWN_V]])).points[0]


def _on_parting(controls: HairStyle, roots: ScalpRoots, body: BodyModel) -> Float[Tensor, " s"]:
    """1 before the end of the parting, 0 behind it."""
    if controls.parting_to_nape:
        return torch.ones(len(roots))
    return torch.sigmoid((_crown(body)[1] - PARTING_END - roots.points[:, 1]) / PARTING_FADE)


def _fringe_tangents(controls: HairStyle, roots: ScalpRoots) -> Float[Tensor, "s 3"]:
    """To the front, down, and to the side that the fringe is swept to."""
    sweep = controls.fringe.sweep if controls.fringe else 0.0
    # Hair of the temples falls beside the face, that of the middle on the forehead.
    aside = 0.4 * roots.from_head[:, 0] / 0.05
    field = torch.stack([aside + sweep, torch.full_like(aside, -1.0), torch.full_like(aside, -0.5)], dim=1)
    return normalize(along_scalp(field, roots.normals), dim=-1)


def falling_directions(controls: HairStyle, roots: ScalpRoots, fringe: Bool[Tensor, " s"]) -> Float[Tensor, "s 3"]:
    """Where loose hair goes: down, before or behind the shoulders; a fringe down and to its side."""
    x, y, _ = roots.from_head.unbind(1)
    behind = torch.tanh((y - FALL_LINE) / FALL_FADE)
    behind = torch.where(behind < 0, FORWARDS * behind, behind)
    inwards = -INWARDS * torch.tanh(x / FALL_FADE)
    down = torch.stack([inwards, controls.shoulder_split * behind, -torch.ones_like(behind)], dim=1)
    if controls.fringe is not None:
        over_brow = torch.stack([controls.fringe.sweep + 3 * x, 0 * x, -torch.ones_like(x)], dim=1)
        down = torch.where(fringe[:, None], over_brow, down)
    return normalize(down, dim=-1)


def along_scalp(vectors: Float[Tensor, "s 3"], normals: Float[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
    """The part of vectors that lies in the scalp's tangent planes."""
    return vectors - (vectors * normals).sum(-1, keepdim=True) * normals
