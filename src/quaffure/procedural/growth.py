"""Growth of a strand's axis: a direction followed step by step, outside of the body and of the face."""

from dataclasses import dataclass

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import CLEARANCE, CLEARANCE_RAMP, distances_and_normals
from quaffure.hair.scalp_roots import ScalpRoots
from quaffure.procedural.growth_field import falling_directions, growth_directions
from quaffure.procedural.hair_style import HairStyle
from quaffure.procedural.trimming import root_heights
from quaffure.types import Bool, Float, Tensor

# The face, kept free of hair: an ellipsoid with this centre seen from the Head joint and these half axes [m].
FACE_CENTRE, FACE_AXES = (0.0, -0.125, 0.02), (0.073, 0.085, 0.115)
# Hair leaves it this much to the back for every step sideways.
FACE_WAY_BACK = 1.0
# Below this height over the Head joint hair lies on shoulders, not on the head; the change takes this distance [m].
JAW, JAW_FADE = -0.035, 0.02
# Hair that reaches the shoulders passes their ridge, at this height, this far before or behind it [m, from Head] ...
SHOULDER_HEIGHT, SHOULDER_BEFORE, SHOULDER_BEHIND = -0.13, -0.05, 0.07
# ... turning there from this far above it on [m], by at most this slope, and drawn in to the neck by this one.
SHOULDER_APPROACH, STEEPEST_SPLIT, TO_NECK = 0.04, 1.2, 0.06
# Where it lies on the shoulder all the same, this slope leads it off; it lies there closer than this to its layer [m].
OFF_SHOULDER, TOUCH = 0.7, 0.008
# Of the way off a shoulder's skin this share of the sideways part is left out; the rest still leads off it.
ALONG_SHOULDER, LEAST_RISE = 0.85, 0.3
# The line between the two at the height of the jaw [m, from Head]; strands near it go either way [m].
SHOULDER_LINE, SHOULDER_MIXING = 0.005, 0.02
SMOOTHING_ROUNDS = 3
# The left ear with the hair over it: an ellipsoid like the face's. Loose hair passes it outside, held hair above it.
EAR_CENTRE, EAR_AXES = (0.045, 0.0, 0.025), (0.054, 0.062, 0.125)
HELD_EAR_CENTRE, HELD_EAR_AXES = (0.078, 0.0, 0.018), (0.022, 0.026, 0.042)
# Hair that roots above the ears, from this height over the Head joint on, covers them [m]. It has its full distance
# from them after this way [m].
EAR_TOP, EAR_TOP_FADE, EAR_WAY = 0.04, 0.005, 0.08


@dataclass(frozen=True)
class Course:
    """What steers the growth of a set of strands.

    Attributes:
        start: where they begin [m].
        heading: unit direction that they keep at first.
        falling: unit direction that gravity gives them later.
        step: length of one step [m].
        clearance: distance that they keep from the skin [m].
        aside: side of the face that they pass, 1 for the body's left, -1 for its right.
        line: hair that comes down to the jaw behind this line falls behind the shoulders, the rest before them
            [m, backwards from the Head joint].
        opening: width of the region that they leave free, relative to the face.
    """

    start: Float[Tensor, "s 3"]
    heading: Float[Tensor, "s 3"]
    falling: Float[Tensor, "s 3"]
    step: Float[Tensor, " s"]
    clearance: Float[Tensor, " s"]
    aside: Float[Tensor, " s"]
    line: Float[Tensor, " s"]
    opening: Float[Tensor, " s"]


def course_of(
    controls: HairStyle,
    roots: ScalpRoots,
    fringe: Bool[Tensor, " s"],
    lengths: Float[Tensor, " s"],
    steps: int,
    body: BodyModel,
    generator: torch.Generator,
) -> Course:
    """Free hair's course from its roots over `lengths` [m] in so many steps."""
    mixing = SHOULDER_MIXING * (torch.rand(len(roots), generator=generator) - 0.5)
    return Course(
        start=roots.points,
        heading=growth_directions(controls, roots, fringe, body, generator),
        falling=falling_directions(controls, roots, fringe),
        step=lengths / steps,
        clearance=layers(controls, roots, generator),
        aside=torch.where(roots.points[:, 0] >= (controls.parting or 0.0), 1.0, -1.0),
        line=SHOULDER_LINE + mixing,
        opening=torch.where(fringe, 0.0, controls.face_opening),
    )


def layers(controls: HairStyle, roots: ScalpRoots, generator: torch.Generator) -> Float[Tensor, " s"]:
    """Distance that each strand keeps from the skin [m]: hair from above lies on hair from below."""
    share = 0.75 * root_heights(roots) + 0.25 * torch.rand(len(roots), generator=generator)
    return CLEARANCE + controls.layer_thickness * share


def grow(
    course: Course, controls: HairStyle, steps: int, head: Float[Tensor, "3"], surface: Surface
) -> Float[Tensor, "s n 3"]:
    """Axes of `steps` steps, smoothed.

    A step turns towards a target: the heading at first, gravity later; then it slides along what it would enter.
    """
    point, direction, heading = course.start, course.heading, course.heading
    turn = (course.step / controls.stiffness_length).clamp(max=1)[:, None]
    over_ears = torch.sigmoid((course.start[:, 2] - head[2] - EAR_TOP) / EAR_TOP_FADE)
    points, lying, behind = [point], torch.zeros_like(course.step), torch.ones_like(course.step)
    for index in range(steps):
        travelled = course.step * (index + 1)
        fallen = controls.fall * (1 - torch.exp(-((travelled / controls.set_length) ** 2)))[:, None]
        local = point - head
        behind = torch.where(local[:, 2] > JAW, torch.where(local[:, 1] >= course.line, 1.0, -1.0), behind)
        falling = course.falling + _past_shoulders(local, lying, behind)
        target = normalize((1 - fallen) * heading + fallen * falling, dim=-1)
        direction = normalize(direction + turn * (target - direction), dim=-1)
        wanted = point + course.step[:, None] * direction
        distance, normal = distances_and_normals(wanted, surface)
        lowest = torch.minimum(course.clearance, CLEARANCE_RAMP * travelled)
        on_head = torch.sigmoid((wanted[:, 2] - head[2] - JAW) / JAW_FADE)
        drawn = controls.hold * on_head * (distance - lowest).clamp(min=0)
        way = _upwards(normal, 1 - on_head)
        wanted = wanted + (lowest - distance).clamp(min=0)[:, None] * way - drawn[:, None] * normal
        wanted = _beside_face(wanted, head, course)
        if not controls.cut_around_ears:
            wanted = round_ears(wanted, head, over_ears * (travelled / EAR_WAY).clamp(max=1), controls.hold > 0)
        # Held hair takes its heading round the head with it.
        heading = normalize(heading - controls.hold * (heading * normal).sum(-1, keepdim=True) * normal, dim=-1)
        lying = (distance < lowest + TOUCH) * normal[:, 2].clamp(min=0)
        direction = normalize(wanted - point, dim=-1)
        point = point + course.step[:, None] * direction
        points.append(point)
    return smoothed(torch.stack(points, dim=1))


def smoothed(axes: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n 3"]:
    """Without the kinks that the obstacles leave; roots and tips stay."""
    for _ in range(SMOOTHING_ROUNDS):
        inner = 0.25 * axes[:, :-2] + 0.5 * axes[:, 1:-1] + 0.25 * axes[:, 2:]
        axes = torch.cat([axes[:, :1], inner, axes[:, -1:]], dim=1)
    return axes


def _past_shoulders(
    local: Float[Tensor, "s 3"], lying: Float[Tensor, " s"], behind: Float[Tensor, " s"]
) -> Float[Tensor, "s 3"]:
    """What turns falling hair to the front or the back of a shoulder that it would meet.

    Args:
        local: where it is, seen from the Head joint [m].
        lying: how far the body holds it up from below, 0 to 1.
        behind: 1 for hair that passes the shoulder behind it, -1 before it.
    """
    x, y, z = local.unbind(1)
    left = (z - SHOULDER_HEIGHT).clamp(min=SHOULDER_APPROACH)
    forwards = ((SHOULDER_BEFORE - y) / left).clamp(-STEEPEST_SPLIT, 0)
    backwards = ((SHOULDER_BEHIND - y) / left).clamp(0, STEEPEST_SPLIT)
    share = torch.sigmoid((JAW - z) / JAW_FADE)
    slope = torch.where(behind < 0, forwards, backwards) + OFF_SHOULDER * lying * behind
    return share[:, None] * torch.stack([-TO_NECK * x.sign(), slope, torch.zeros_like(slope)], dim=1)


def _upwards(normals: Float[Tensor, "s 3"], share: Float[Tensor, " s"]) -> Float[Tensor, "s 3"]:
    """Ways off the skin, of unit height along its normals: hair that lies on a shoulder does not slide out along it."""
    sideways = torch.stack([ALONG_SHOULDER * share * normals[:, 0], 0 * share, 0 * share], dim=1)
    way = normals - sideways
    return way / (way * normals).sum(-1, keepdim=True).clamp(min=LEAST_RISE)


def _beside_face(points: Float[Tensor, "s 3"], head: Float[Tensor, "3"], course: Course) -> Float[Tensor, "s 3"]:
    """Points in the region of the face moved out of it, sideways and back, each to its own side of the parting."""
    width = torch.stack([course.opening, torch.ones_like(course.opening), torch.ones_like(course.opening)], dim=1)
    axes = torch.tensor(FACE_AXES) * width.clamp(min=1e-3)
    way = torch.stack([course.aside, torch.full_like(course.aside, FACE_WAY_BACK), 0 * course.aside], dim=1)
    move = way_out(points - head - torch.tensor(FACE_CENTRE), axes, way)
    return points + (course.opening > 0)[:, None] * move


def round_ears(
    points: Float[Tensor, "s 3"], head: Float[Tensor, "3"], share: Float[Tensor, " s"], held: bool
) -> Float[Tensor, "s 3"]:
    """Points in the region of an ear moved out of it by `share` of the way: outwards, or upwards where held."""
    side = torch.where(points[:, :1] >= 0, 1.0, -1.0) * torch.tensor([1.0, 0.0, 0.0])
    centre, axes = (HELD_EAR_CENTRE, HELD_EAR_AXES) if held else (EAR_CENTRE, EAR_AXES)
    way = 0.2 * side + torch.tensor([0.0, 0.0, 1.0]) if held else side
    local = points - head - centre[0] * side - torch.tensor([0.0, *centre[1:]])
    # Not hair on top of the head, which the ellipsoid reaches into.
    share = share * ((local * side).sum(1) > 0)
    return points + share[:, None] * way_out(local, torch.tensor(axes).expand_as(local), way)


def way_out(local: Float[Tensor, "s 3"], axes: Float[Tensor, "s 3"], way: Float[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
    """Move along `way` that takes points, seen from an ellipsoid's centre, out of it; zero for those outside."""
    point, along = local / axes, way / axes
    # The far end of the way through the unit sphere: |point + t along| = 1.
    half, square = (point * along).sum(1), along.square().sum(1)
    inside = 1 - point.square().sum(1)
    exit_distance = (-half + (half.square() + square * inside).clamp(min=0).sqrt()) / square
    return torch.where(inside > 0, exit_distance, 0.0)[:, None] * way
