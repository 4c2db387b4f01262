"""Growth of a strand's axis: a direction field followed step by step, outside of the body and of the face."""

import math

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.geometry.surface import Surface
from quaffure.groom.clearance import CLEARANCE, CLEARANCE_RAMP, distances_and_normals
from quaffure.groom.hair_style import HairStyle
from quaffure.types import Float, Tensor

# The face, kept free of hair: an ellipsoid with this centre seen from the Head joint and these half axes [m].
FACE_CENTRE, FACE_AXES = (0.0, -0.125, 0.02), (0.073, 0.085, 0.115)
# Hair leaves it this much to the back for every step sideways.
FACE_WAY_BACK = 1.0
# The parting ends this far before the crown, and fades out over this distance [m].
PARTING_END, PARTING_FADE = 0.015, 0.012
# Hair that grows behind this line, seen from the Head joint, falls behind the shoulders [m]; the rest before them.
SHOULDER_LINE, SHOULDER_FADE = -0.035, 0.02
# Hair before the shoulders hangs steeper than hair behind them.
FORWARDS = 0.15
# Loose hair draws in towards the neck by this slope.
INWARDS = 0.1
SMOOTHING_ROUNDS = 3
# Where the crown is, between the forehead's and the nape's rim of the chart.
CROWN_V = 0.47


def grow(
    controls: HairStyle,
    roots: Float[Tensor, "s 3"],
    normals: Float[Tensor, "s 3"],
    step: Float[Tensor, " s"],
    steps: int,
    body: BodyModel,
    surface: Surface,
    generator: torch.Generator,
) -> Float[Tensor, "s n 3"]:
    """Axes of `steps` steps [m] each, from the roots on.

    A step turns towards a target: the direction of growth at first, gravity later; then it slides along what it
    would enter.
    """
    head = body.rest_joints[body.joint_names.index("Head")]
    tangent = growth_tangents(controls, roots, normals, body)
    lift = math.radians(controls.lift_deg)
    growth = math.cos(lift) * tangent + math.sin(lift) * normals
    down = _falling(controls, roots, head)
    clearance = _layers(controls, roots, generator)
    side = torch.where(roots[:, 0] >= (controls.parting or 0.0), 1.0, -1.0)
    point, direction, turn = roots, growth, (step / controls.stiffness_length).clamp(max=1)[:, None]
    points = [roots]
    for index in range(steps):
        travelled = step * (index + 1)
        fallen = controls.fall * (1 - torch.exp(-((travelled / controls.set_length) ** 2)))[:, None]
        target = normalize((1 - fallen) * growth + fallen * down, dim=-1)
        direction = normalize(direction + turn * (target - direction), dim=-1)
        wanted = point + step[:, None] * direction
        wanted = _outside(wanted, torch.minimum(clearance, CLEARANCE_RAMP * travelled), surface)
        wanted = _beside_face(wanted, head, controls.face_opening, side)
        direction = normalize(wanted - point, dim=-1)
        point = point + step[:, None] * direction
        points.append(point)
    return _smoothed(torch.stack(points, dim=1))


def _smoothed(axes: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n 3"]:
    """Without the kinks that the obstacles leave; roots and tips stay."""
    for _ in range(SMOOTHING_ROUNDS):
        inner = 0.25 * axes[:, :-2] + 0.5 * axes[:, 1:-1] + 0.25 * axes[:, 2:]
        axes = torch.cat([axes[:, :1], inner, axes[:, -1:]], dim=1)
    return axes


def growth_tangents(
    controls: HairStyle, roots: Float[Tensor, "s 3"], normals: Float[Tensor, "s 3"], body: BodyModel
) -> Float[Tensor, "s 3"]:
    """Unit directions of growth in the scalp's tangent planes."""
    face, barycentric = body.scalp.locate(torch.tensor([[0.5, CROWN_V]]))
    crown = (barycentric[..., None] * body.rest_vertices[body.faces[face]]).sum(-2)[0]
    # The parting runs into the crown; between the two, hair would grow both ways at once.
    crown = crown + torch.tensor([controls.parting or 0.0, 0.0, 0.0])
    field = controls.from_crown * normalize(_along(roots - crown, normals), dim=-1)
    field = field + controls.backwards * torch.tensor([0.0, 1.0, -0.5])
    if controls.parting is not None:
        ahead = torch.sigmoid((crown[1] - PARTING_END - roots[:, 1]) / PARTING_FADE)
        sideways = torch.where(roots[:, :1] >= controls.parting, 1.0, -1.0) * torch.tensor([1.0, 0.0, -0.2])
        field = field + controls.from_parting * ahead[:, None] * sideways
    return normalize(_along(field, normals), dim=-1)


def _falling(controls: HairStyle, roots: Float[Tensor, "s 3"], head: Float[Tensor, "3"]) -> Float[Tensor, "s 3"]:
    """Where loose hair goes: down, before or behind the shoulders."""
    behind = torch.tanh((roots[:, 1] - head[1] - SHOULDER_LINE) / SHOULDER_FADE)
    behind = torch.where(behind < 0, FORWARDS * behind, behind)
    inwards = -INWARDS * torch.tanh(roots[:, 0] / SHOULDER_FADE)
    return normalize(torch.stack([inwards, controls.shoulder_split * behind, -torch.ones_like(behind)], dim=1), dim=-1)


def _along(vectors: Float[Tensor, "s 3"], normals: Float[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
    return vectors - (vectors * normals).sum(-1, keepdim=True) * normals


def _layers(controls: HairStyle, roots: Float[Tensor, "s 3"], generator: torch.Generator) -> Float[Tensor, " s"]:
    """Distance that each strand keeps from the skin [m]: hair from above lies on hair from below."""
    height = (roots[:, 2] - roots[:, 2].min()) / (roots[:, 2].max() - roots[:, 2].min())
    return CLEARANCE + controls.layer_thickness * (0.75 * height + 0.25 * torch.rand(len(roots), generator=generator))


def _outside(points: Float[Tensor, "s 3"], clearance: Float[Tensor, " s"], surface: Surface) -> Float[Tensor, "s 3"]:
    distance, normal = distances_and_normals(points, surface)
    return points + (clearance - distance).clamp(min=0)[:, None] * normal


def _beside_face(
    points: Float[Tensor, "s 3"], head: Float[Tensor, "3"], opening: float, side: Float[Tensor, " s"]
) -> Float[Tensor, "s 3"]:
    """Points in the region of the face moved out of it, sideways and back, each to its own side of the parting."""
    if opening <= 0:
        return points
    axes = torch.tensor(FACE_AXES) * torch.tensor([opening, 1.0, 1.0])
    local = (points - head - torch.tensor(FACE_CENTRE)) / axes
    way = torch.stack([side, torch.full_like(side, FACE_WAY_BACK), torch.zeros_like(side)], dim=1) / axes
    # The far end of the way through the unit sphere: |local + t way| = 1.
    half, square = (local * way).sum(1), way.square().sum(1)
    inside = 1 - local.square().sum(1)
    exit_distance = (-half + (half.square() + square * inside).clamp(min=0).sqrt()) / square
    return points + torch.where(inside > 0, exit_distance, 0.0)[:, None] * way * axes
