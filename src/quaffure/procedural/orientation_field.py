"""The orientation field: the direction of hair at every root, and the direction in which loose hair hangs."""

import math

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.hair.scalp_roots import ScalpRoots, roots_at
from quaffure.procedural.hair_style import HairStyle
from quaffure.procedural.trimming import clipped_share
from quaffure.types import Bool, Float, Tensor

# Distance from the crown to the end of the parting, and width of its transition [m].
PARTING_END, PARTING_FADE = 0.015, 0.012
# Near the parting and the crown hair lies flat: this share of its lift remains there; width of the region [m].
FLAT_LIFT, FLAT_WIDTH = 0.3, 0.04
# Hair with roots behind this line, relative to the Head joint, falls backwards, the rest forwards; transition [m].
HANGING_LINE, HANGING_FADE = -0.005, 0.02
# Relative slope of hair before the shoulders, which hangs steeper than hair behind them.
FORWARD_SLOPE = 0.15
# Slope of loose hair towards the neck.
INWARD_SLOPE = 0.1
# Position of the crown on the scalp chart, from forehead to nape.
CROWN_V = 0.47
# Angle between clipped hair and the scalp [degrees].
CLIPPED_LIFT_DEG = 35.0
# Lift of a fringe relative to the rest.
FRINGE_LIFT = 0.5


def root_directions(
    controls: HairStyle, roots: ScalpRoots, fringe: Bool[Tensor, " s"], body: BodyModel, generator: torch.Generator
) -> Float[Tensor, "s 3"]:
    """Unit directions at the roots: combed tangents, lifted off the scalp."""
    tangents = torch.where(fringe[:, None], _fringe_tangents(controls, roots), root_tangents(controls, roots, body))
    lift = torch.full((len(roots),), math.radians(controls.lift_deg))
    # Upright hair covers the parting.
    lift = lift * (1 - (1 - FLAT_LIFT) * torch.cos(lift) * _divergence(controls, roots, body))
    clipped = clipped_share(controls, roots)
    lift = torch.where(fringe, FRINGE_LIFT * lift, lift)
    lift = (lift + clipped * (math.radians(CLIPPED_LIFT_DEG) - lift))[:, None]
    directions = torch.cos(lift) * tangents + torch.sin(lift) * roots.normals
    noise = math.radians(controls.direction_variation_deg) * torch.randn(directions.shape, generator=generator)
    return normalize(directions + noise, dim=-1)


def _divergence(controls: HairStyle, roots: ScalpRoots, body: BodyModel) -> Float[Tensor, " s"]:
    """1 on the parting and on the crown, from which directions diverge, fading to 0 next to them."""
    divergence = torch.zeros(len(roots))
    if controls.parting is not None and controls.from_parting > 0:
        aside = (roots.points[:, 0] - controls.parting) / FLAT_WIDTH
        divergence = _on_parting(controls, roots, body) * torch.exp(-aside.square())
    if controls.from_crown > 0:
        from_crown = (roots.points - _crown(body)).norm(dim=1) / FLAT_WIDTH
        divergence = torch.maximum(divergence, torch.exp(-from_crown.square()))
    return divergence


def root_tangents(controls: HairStyle, roots: ScalpRoots, body: BodyModel) -> Float[Tensor, "s 3"]:
    """Unit directions in the scalp's tangent planes."""
    # The parting ends at the crown; between the two, opposite directions would meet.
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
    """1 in front of the end of the parting, 0 behind it."""
    if controls.parting_to_nape:
        return torch.ones(len(roots))
    return torch.sigmoid((_crown(body)[1] - PARTING_END - roots.points[:, 1]) / PARTING_FADE)


def _fringe_tangents(controls: HairStyle, roots: ScalpRoots) -> Float[Tensor, "s 3"]:
    """Unit directions to the front, down, and to the side of the fringe's sweep."""
    sweep = controls.fringe.sweep if controls.fringe else 0.0
    # Hair of the temples falls next to the face, hair of the middle on the forehead.
    aside = 0.4 * roots.from_head[:, 0] / 0.05
    field = torch.stack([aside + sweep, torch.full_like(aside, -1.0), torch.full_like(aside, -0.5)], dim=1)
    return normalize(along_scalp(field, roots.normals), dim=-1)


def hanging_directions(controls: HairStyle, roots: ScalpRoots, fringe: Bool[Tensor, " s"]) -> Float[Tensor, "s 3"]:
    """Unit directions of loose hair: down, before or behind the shoulders; of a fringe down and to its side."""
    x, y, _ = roots.from_head.unbind(1)
    behind = torch.tanh((y - HANGING_LINE) / HANGING_FADE)
    behind = torch.where(behind < 0, FORWARD_SLOPE * behind, behind)
    inwards = -INWARD_SLOPE * torch.tanh(x / HANGING_FADE)
    down = torch.stack([inwards, controls.shoulder_split * behind, -torch.ones_like(behind)], dim=1)
    if controls.fringe is not None:
        over_brow = torch.stack([controls.fringe.sweep + 3 * x, 0 * x, -torch.ones_like(x)], dim=1)
        down = torch.where(fringe[:, None], over_brow, down)
    return normalize(down, dim=-1)


def along_scalp(vectors: Float[Tensor, "s 3"], normals: Float[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
    """Projection of vectors onto the scalp's tangent planes."""
    return vectors - (vectors * normals).sum(-1, keepdim=True) * normals
