"""Tracing of strand axes through the orientation field, step by step, outside of the body and of the face region."""

from dataclasses import dataclass

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import CLEARANCE, CLEARANCE_RAMP, distances_and_normals
from quaffure.hair.scalp_roots import ScalpRoots
from quaffure.procedural.hair_style import HairStyle
from quaffure.procedural.orientation_field import hanging_directions, root_directions
from quaffure.procedural.trimming import root_heights
from quaffure.types import Bool, Float, Tensor

# The face region, kept free of hair: an ellipsoid with this centre relative to the Head joint and these half axes [m].
FACE_CENTRE, FACE_AXES = (0.0, -0.125, 0.02), (0.073, 0.085, 0.115)
# Backward part of the direction in which hair is projected out of it; the sideways part is 1.
FACE_EXIT_BACKWARDS = 1.0
# Below this height above the Head joint hair lies on shoulders, not on the head; width of the transition [m].
JAW, JAW_FADE = -0.035, 0.02
# Hair that reaches the shoulders passes their ridge, at this height, this far before or behind it [m, from Head] ...
SHOULDER_HEIGHT, SHOULDER_BEFORE, SHOULDER_BEHIND = -0.13, -0.05, 0.07
# ... deflected there from this height above it on [m], by at most this slope, and towards the neck by this one.
SHOULDER_APPROACH, STEEPEST_SPLIT, TO_NECK = 0.04, 1.2, 0.06
# Where it touches the shoulder anyway, it slides off at this slope; it touches within this distance of its layer [m].
OFF_SHOULDER, TOUCH = 0.7, 0.008
# Share of the sideways part that is removed from the push off a shoulder; the rest has at least this normal part.
ALONG_SHOULDER, LEAST_RISE = 0.85, 0.3
# The line between the two at the height of the jaw [m, from Head], and its random range [m].
SHOULDER_LINE, SHOULDER_MIXING = 0.005, 0.02
SMOOTHING_ROUNDS = 3
# The left ear with the hair over it: an ellipsoid like the face's. Loose hair passes it outside, held hair above it.
EAR_CENTRE, EAR_AXES = (0.045, 0.0, 0.025), (0.054, 0.062, 0.125)
HELD_EAR_CENTRE, HELD_EAR_AXES = (0.078, 0.0, 0.018), (0.022, 0.026, 0.042)
# Hair with its roots above the ears, from this height above the Head joint on, covers them [m]. It reaches its full
# distance from them after this length [m].
EAR_TOP, EAR_TOP_FADE, EAR_LENGTH = 0.04, 0.005, 0.08


@dataclass(frozen=True)
class TraceInputs:
    """Per-strand inputs of the tracing.

    Attributes:
        start: first point [m].
        root_direction: unit direction at the start.
        hanging_direction: unit direction under gravity, approached along the strand.
        step: length of one step [m].
        clearance: distance from the skin [m].
        face_side: side of the face on which a strand passes, 1 for the body's left, -1 for its right.
        shoulder_line: hair that comes down to the jaw behind this line falls behind the shoulders, the rest before
            them [m, backwards from the Head joint].
        face_opening: width of the region without hair, relative to the face.
    """

    start: Float[Tensor, "s 3"]
    root_direction: Float[Tensor, "s 3"]
    hanging_direction: Float[Tensor, "s 3"]
    step: Float[Tensor, " s"]
    clearance: Float[Tensor, " s"]
    face_side: Float[Tensor, " s"]
    shoulder_line: Float[Tensor, " s"]
    face_opening: Float[Tensor, " s"]


def free_hair_inputs(
    controls: HairStyle,
    roots: ScalpRoots,
    fringe: Bool[Tensor, " s"],
    lengths: Float[Tensor, " s"],
    steps: int,
    body: BodyModel,
    generator: torch.Generator,
) -> TraceInputs:
    """Inputs of untied hair that is traced from its roots over `lengths` [m] in `steps` steps."""
    mixing = SHOULDER_MIXING * (torch.rand(len(roots), generator=generator) - 0.5)
    return TraceInputs(
        start=roots.points,
        root_direction=root_directions(controls, roots, fringe, body, generator),
        hanging_direction=hanging_directions(controls, roots, fringe),
        step=lengths / steps,
        clearance=layer_clearance(controls, roots, generator),
        face_side=torch.where(roots.points[:, 0] >= (controls.parting or 0.0), 1.0, -1.0),
        shoulder_line=SHOULDER_LINE + mixing,
        face_opening=torch.where(fringe, 0.0, controls.face_opening),
    )


def layer_clearance(controls: HairStyle, roots: ScalpRoots, generator: torch.Generator) -> Float[Tensor, " s"]:
    """Distance of each strand from the skin [m]: hair with higher roots lies on hair with lower ones."""
    share = 0.75 * root_heights(roots) + 0.25 * torch.rand(len(roots), generator=generator)
    return CLEARANCE + controls.layer_thickness * share


def trace_strands(
    inputs: TraceInputs, controls: HairStyle, steps: int, head: Float[Tensor, "3"], surface: Surface
) -> Float[Tensor, "s n 3"]:
    """Axes of `steps` steps, smoothed.

    A step rotates towards a target: the root direction at first, gravity later; then it is projected out of obstacles.
    """
    point, direction, root_direction = inputs.start, inputs.root_direction, inputs.root_direction
    blend = (inputs.step / controls.stiffness_length).clamp(max=1)[:, None]
    over_ears = torch.sigmoid((inputs.start[:, 2] - head[2] - EAR_TOP) / EAR_TOP_FADE)
    points, support, behind = [point], torch.zeros_like(inputs.step), torch.ones_like(inputs.step)
    for index in range(steps):
        length = inputs.step * (index + 1)
        fall = controls.fall * (1 - torch.exp(-((length / controls.set_length) ** 2)))[:, None]
        local = point - head
        behind = torch.where(local[:, 2] > JAW, torch.where(local[:, 1] >= inputs.shoulder_line, 1.0, -1.0), behind)
        hanging = inputs.hanging_direction + _shoulder_deflection(local, support, behind)
        target = normalize((1 - fall) * root_direction + fall * hanging, dim=-1)
        direction = normalize(direction + blend * (target - direction), dim=-1)
        moved = point + inputs.step[:, None] * direction
        distance, normal = distances_and_normals(moved, surface)
        lowest = torch.minimum(inputs.clearance, CLEARANCE_RAMP * length)
        on_head = torch.sigmoid((moved[:, 2] - head[2] - JAW) / JAW_FADE)
        attraction = controls.hold * on_head * (distance - lowest).clamp(min=0)
        push = (lowest - distance).clamp(min=0)[:, None] * _push_direction(normal, 1 - on_head)
        moved = _out_of_face(moved + push - attraction[:, None] * normal, head, inputs)
        if not controls.cut_around_ears:
            moved = out_of_ears(moved, head, over_ears * (length / EAR_LENGTH).clamp(max=1), controls.hold > 0)
        # The root direction of held hair follows the curvature of the head.
        across = controls.hold * (root_direction * normal).sum(-1, keepdim=True)
        root_direction = normalize(root_direction - across * normal, dim=-1)
        support = (distance < lowest + TOUCH) * normal[:, 2].clamp(min=0)
        direction = normalize(moved - point, dim=-1)
        point = point + inputs.step[:, None] * direction
        points.append(point)
    return smoothed(torch.stack(points, dim=1))


def smoothed(axes: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n 3"]:
    """Without the kinks caused by obstacles; roots and tips stay."""
    for _ in range(SMOOTHING_ROUNDS):
        inner = 0.25 * axes[:, :-2] + 0.5 * axes[:, 1:-1] + 0.25 * axes[:, 2:]
        axes = torch.cat([axes[:, :1], inner, axes[:, -1:]], dim=1)
    return axes


def _shoulder_deflection(
    local: Float[Tensor, "s 3"], support: Float[Tensor, " s"], behind: Float[Tensor, " s"]
) -> Float[Tensor, "s 3"]:
    """Change of the hanging direction towards the front or the back of a shoulder below.

    Args:
        local: points relative to the Head joint [m].
        support: upward part of the normal where the body supports the hair from below, else 0.
        behind: 1 for hair that passes the shoulder behind it, -1 before it.
    """
    x, y, z = local.unbind(1)
    height = (z - SHOULDER_HEIGHT).clamp(min=SHOULDER_APPROACH)
    forwards = ((SHOULDER_BEFORE - y) / height).clamp(-STEEPEST_SPLIT, 0)
    backwards = ((SHOULDER_BEHIND - y) / height).clamp(0, STEEPEST_SPLIT)
    share = torch.sigmoid((JAW - z) / JAW_FADE)
    slope = torch.where(behind < 0, forwards, backwards) + OFF_SHOULDER * support * behind
    return share[:, None] * torch.stack([-TO_NECK * x.sign(), slope, torch.zeros_like(slope)], dim=1)


def _push_direction(normals: Float[Tensor, "s 3"], share: Float[Tensor, " s"]) -> Float[Tensor, "s 3"]:
    """Directions off the skin with unit normal part: hair on a shoulder is not pushed outwards along it."""
    sideways = torch.stack([ALONG_SHOULDER * share * normals[:, 0], 0 * share, 0 * share], dim=1)
    direction = normals - sideways
    return direction / (direction * normals).sum(-1, keepdim=True).clamp(min=LEAST_RISE)


def _out_of_face(points: Float[Tensor, "s 3"], head: Float[Tensor, "3"], inputs: TraceInputs) -> Float[Tensor, "s 3"]:
    """Points in the face region moved out of it, sideways and back, each to its own side of the parting."""
    opening, side = inputs.face_opening, inputs.face_side
    width = torch.stack([opening, torch.ones_like(opening), torch.ones_like(opening)], dim=1)
    axes = torch.tensor(FACE_AXES) * width.clamp(min=1e-3)
    direction = torch.stack([side, torch.full_like(side, FACE_EXIT_BACKWARDS), 0 * side], dim=1)
    move = ellipsoid_exit(points - head - torch.tensor(FACE_CENTRE), axes, direction)
    return points + (opening > 0)[:, None] * move


def out_of_ears(
    points: Float[Tensor, "s 3"], head: Float[Tensor, "3"], share: Float[Tensor, " s"], held: bool
) -> Float[Tensor, "s 3"]:
    """Points in the region of an ear moved by `share` of the distance out of it: outwards, or upwards where held."""
    side = torch.where(points[:, :1] >= 0, 1.0, -1.0) * torch.tensor([1.0, 0.0, 0.0])
    centre, axes = (HELD_EAR_CENTRE, HELD_EAR_AXES) if held else (EAR_CENTRE, EAR_AXES)
    direction = 0.2 * side + torch.tensor([0.0, 0.0, 1.0]) if held else side
    local = points - head - centre[0] * side - torch.tensor([0.0, *centre[1:]])
    # Not hair on top of the head, which is partly inside the ellipsoid.
    share = share * ((local * side).sum(1) > 0)
    return points + share[:, None] * ellipsoid_exit(local, torch.tensor(axes).expand_as(local), direction)


def ellipsoid_exit(
    local: Float[Tensor, "s 3"], axes: Float[Tensor, "s 3"], direction: Float[Tensor, "s 3"]
) -> Float[Tensor, "s 3"]:
    """Displacements along `direction` to the surface of an ellipsoid, for points inside it; zero for the others.

    Args:
        local: points relative to the ellipsoid's centre [m].
        axes: half axes [m].
    """
    point, along = local / axes, direction / axes
    # The far intersection with the unit sphere: |point + t along| = 1.
    half, square = (point * along).sum(1), along.square().sum(1)
    inside = 1 - point.square().sum(1)
    exit_distance = (-half + (half.square() + square * inside).clamp(min=0).sqrt()) / square
    return torch.where(inside > 0, exit_distance, 0.0)[:, None] * direction
