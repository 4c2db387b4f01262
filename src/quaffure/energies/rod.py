"""Kirchhoff rod in edge directions: bending relative to the previous edge, twist at its equilibrium.

    E = sum_i  B_i / 2 |t_i - M_i r_i|^2  +  C_i / 2 (phi_i - phi_(i-1) - psi_i)^2  +  G_i / 2 |t_i - R g_i|^2

t_i are the unit directions of the edges and F_i their frames (tangent, normal, binormal): the root's frame R,
transported along the strand without twist. phi_i is the angle by which hair is twisted about t_i relative to F_i. The
joint before edge i bends from the material frame M_i = F_(i-1) rotated about t_(i-1) by (phi_(i-1) + phi_i) / 2; with
phi_(i-1) alone the error would be of first order in the edges' length instead of second. R stands in for the frame of
an edge -1 with phi_(-1) = 0. r_i is the rest direction of edge i in M_i, psi_i the rest twist. B_i = scale_i EI / l_i
and C_i = scale_i GJ / l_i, l_i the length between the middles of two edges, half an edge at the root. The last sum is
Eq. 6 with a weight of its own, for hair that is held.

The twist angles are no unknowns of a solver: they minimise E at every shape (quasi-static material frame; Bergou et
al. 2008, "Discrete Elastic Rods"). The derivative of E by phi is zero there, so the gradient by t needs no derivative
of phi (envelope theorem). A second derivative does, so autograd can't be applied twice.

This module is the torch form; `quaffure.energies.rod_kernels` is the compiled one.
"""

from dataclasses import dataclass, fields, replace
from numbers import Real

import torch

from quaffure.config import BENDING_STIFFNESS, TWISTING_STIFFNESS
from quaffure.errors import InputError
from quaffure.geometry.polyline import directors
from quaffure.geometry.rotation import any_normal
from quaffure.types import EdgeVectors, Energy, Float, Positions, RestLengths, Tensor

SHORTEST_JOINT = 2e-4
"""Least length over which a joint bends [m]: edges of no length must not be infinitely stiff."""
LEAST_ALIGNMENT = 1e-5
"""Least 1 + cos(angle) between edges in the transport of a frame, which is undefined where an edge folds back."""
MOST_TWIST_STEPS = 30
TWIST_TOLERANCE = 1e-5
"""A step that changes twist less than this is the last one [rad]. The error left is of its square, or of its own size
where a joint is far from its own minimum."""
SAFE_CURVATURE = 0.472
"""Least curvature of -cos(x) that Newton's method assumes, over cos(x / 2): no less than half of sin(x) / x, which is
the curvature of the parabola that touches -cos at x and lies above it elsewhere. So no step raises the energy."""
EXACT_BELOW = 0.3
"""After a step below this, the curvature is the exact one [rad]: safe steps converge linearly, these quadratically."""
LEAST_PIVOT = 1e-2
"""Least pivot of an elimination with exact curvatures, in twisting stiffnesses of the joint."""

STIFFNESS_FACTORS = 1e-4, 1e4
"""Limits of a factor of the stiffness; human hair is within 0.3 and 3."""

Twist = Float[Tensor, "b s e"]
RootRotations = Float[Tensor, "b s 3 3"]


def check_stiffness(stiffness: float | Float[Tensor, "s e"]) -> None:
    """Refuse factors of the stiffness that are not within `STIFFNESS_FACTORS`.

    Raises:
        InputError: there is one.
    """
    least, most = STIFFNESS_FACTORS
    low = high = stiffness
    if isinstance(stiffness, Tensor):
        low, high = map(float, stiffness.detach().aminmax())
    if not (isinstance(low, Real) and least <= low and high <= most):
        raise InputError("stiffness", f"factors above 0, from {least:g} to {most:g}", f"{low!s:.20} to {high!s:.20}")


@dataclass(frozen=True, eq=False)
class RodRest:
    """The rest shape and the stiffness of every strand of a groom.

    Attributes:
        bending_stiffness: B [J], `stiffness_scale` included.
        twisting_stiffness: C [J], `stiffness_scale` included.
        rest_direction: r, components along tangent, normal and binormal of the edge before; unit.
        rest_twist: psi [rad].
        root_frame: tangent and normal of the frame at the root of the rest groom; the binormal is their cross product.
        stiffness_scale: multiple of a human hair's stiffness.
        goal_weight: G [J]; zero for free hair.
        goal_direction: g, in the axes of the rest groom; unit.
    """

    bending_stiffness: Float[Tensor, "s e"]
    twisting_stiffness: Float[Tensor, "s e"]
    rest_direction: Float[Tensor, "s e 3"]
    rest_twist: Float[Tensor, "s e"]
    root_frame: Float[Tensor, "s 2 3"]
    stiffness_scale: Float[Tensor, "s e"]
    goal_weight: Float[Tensor, "s e"]
    goal_direction: Float[Tensor, "s e 3"]

    def to(self, device_or_dtype: torch.device | torch.dtype | str) -> "RodRest":
        """The same rest shape on a device or in a float dtype."""
        return RodRest(*(getattr(self, field.name).to(device_or_dtype) for field in fields(self)))

    def stiffened(self, factor: float | Float[Tensor, "s e"]) -> "RodRest":
        """The same rest shape of hair that is stiffer by a factor, of all edges or of each; goals are not."""
        return replace(
            self,
            bending_stiffness=factor * self.bending_stiffness,
            twisting_stiffness=factor * self.twisting_stiffness,
            stiffness_scale=factor * self.stiffness_scale,
        )


def joint_lengths(rest_length: RestLengths) -> RestLengths:
    """Length that each joint stands for [m]: between the middles of two edges, half an edge at the root."""
    joints = torch.cat([0.5 * rest_length[:, :1], 0.5 * (rest_length[:, 1:] + rest_length[:, :-1])], dim=1)
    return joints.clamp(min=SHORTEST_JOINT)


def transport(vector: Float[Tensor, "*n 3"], start: Float[Tensor, "*n 3"], end: Float[Tensor, "*n 3"]) -> Tensor:
    """A `vector` across the unit vector `start`, rotated by the smallest rotation from `start` to the unit `end`."""
    aligned = (1 + (start * end).sum(-1, keepdim=True)).clamp(min=LEAST_ALIGNMENT)
    return vector - (vector * end).sum(-1, keepdim=True) / aligned * (start + end)


def transported_normals(
    root_tangent: Float[Tensor, "*n 3"], root_normal: Float[Tensor, "*n 3"], directions: Float[Tensor, "*n e 3"]
) -> Float[Tensor, "*n e 3"]:
    """Normals of the frames F_i: the root's, transported from edge to edge."""
    normals, before, normal = [], root_tangent, root_normal
    for direction in directions.unbind(-2):
        normal = transport(normal, before, direction)
        before = direction
        normals.append(normal)
    return torch.stack(normals, dim=-2)


def in_frames(
    vectors: Float[Tensor, "*n 3"], tangent: Float[Tensor, "*n 3"], normal: Float[Tensor, "*n 3"]
) -> Float[Tensor, "*n 3"]:
    """Components along tangent, normal and binormal."""
    binormal = torch.linalg.cross(tangent, normal)
    return torch.stack([(vectors * axis).sum(-1) for axis in (tangent, normal, binormal)], dim=-1)


def joint_stiffness(
    rest_length: RestLengths,
    scale: float | Float[Tensor, "s e"] = 1.0,
    bend: float = BENDING_STIFFNESS,
    twist: float = TWISTING_STIFFNESS,
) -> tuple[Float[Tensor, "s e"], Float[Tensor, "s e"]]:
    """B = scale EI / l and C = scale GJ / l of every joint [J].

    Args:
        rest_length: of the edges [m].
        scale: multiple of the stiffness, of all edges or of each.
        bend, twist: EI and GJ [N m^2]; a human hair's by default.
    """
    joint = joint_lengths(rest_length)
    return scale * bend / joint, scale * twist / joint


def stress_free_rest(
    strands: Float[Tensor, "s n 3"],
    stiffness_scale: Float[Tensor, "s e"] | None = None,
    bend: float = BENDING_STIFFNESS,
    twist: float = TWISTING_STIFFNESS,
    goal_weight: Float[Tensor, "s e"] | None = None,
) -> RodRest:
    """The rod whose shape without any load is the groom as it is.

    Args:
        strands: vertices of the rest groom [m].
        stiffness_scale: of every edge; 1 without.
        bend, twist: EI and GJ [N m^2].
        goal_weight: with which every edge is held to its direction in the groom [J]; none is held without.

    Raises:
        InputError: a strand folds back.
    """
    direction, rest_length = directors(strands), strands.diff(dim=1).norm(dim=-1)
    scale = torch.ones_like(rest_length) if stiffness_scale is None else stiffness_scale
    bending, twisting = joint_stiffness(rest_length, scale, bend, twist)
    before, normal = previous_frames(direction)
    return RodRest(
        bending_stiffness=bending,
        twisting_stiffness=twisting,
        rest_direction=in_frames(direction, before, normal),
        rest_twist=torch.zeros_like(rest_length),
        root_frame=torch.stack([before[:, 0], normal[:, 0]], dim=1),
        stiffness_scale=scale,
        goal_weight=torch.zeros_like(rest_length) if goal_weight is None else goal_weight,
        goal_direction=direction,
    )


def previous_frames(direction: Float[Tensor, "s e 3"]) -> tuple[Float[Tensor, "s e 3"], Float[Tensor, "s e 3"]]:
    """Tangent and normal of the frame before each edge of rest strands; at the root the tangent is the first edge's.

    Raises:
        InputError: two edges fold back by more than 179.6 degrees, so that no frame can be transported across them.
    """
    before = torch.cat([direction[:, :1], direction[:, :-1]], dim=1)
    folded = (1 + (before * direction).sum(-1) < LEAST_ALIGNMENT).nonzero()
    if len(folded):
        strand, vertex = folded[0].tolist()
        found = f"{len(folded)} sharper folds, the first in strand {strand} at vertex {vertex}"
        raise InputError("groom for the rod", "bends of less than 179.6 degrees at every vertex", found)
    root_normal = any_normal(direction[:, 0])
    normals = transported_normals(direction[:, 0], root_normal, direction)
    return before, torch.cat([root_normal[:, None], normals[:, :-1]], dim=1)


def energy_rod(positions: Positions, rest: RodRest, rotation: RootRotations) -> Energy:
    """The rod's energy at the equilibrium of its twist [J], differentiable once.

    Args:
        positions: draped vertices [m].
        rest: of the same groom, in the dtype of the positions.
        rotation: of every strand's scalp triangle from rest to the posed body (`root_rotations`).
    """
    direction = directors(positions)
    with torch.no_grad():
        twist = equilibrium_twist(direction, rest, rotation)
    return energy_at_twist(direction, twist, rest, rotation)


def energy_at_twist(direction: EdgeVectors, twist: Twist, rest: RodRest, rotation: RootRotations) -> Energy:
    """The module's equation for given unit directions t and twist angles phi [J], differentiable in both."""
    bent = rest.bending_stiffness * (direction - rest_targets(direction, twist, rest, rotation)).square().sum(-1)
    twisted = rest.twisting_stiffness * twist_strain(twist, rest).square()
    goal = torch.einsum("bsij,sej->bsei", rotation, rest.goal_direction)
    held = rest.goal_weight * (direction - goal).square().sum(-1)
    return 0.5 * (bent + twisted + held).sum(dim=(1, 2))


def twist_strain(twist: Twist, rest: RodRest) -> Twist:
    """phi_i - phi_(i-1) - psi_i [rad]."""
    return twist.diff(dim=-1, prepend=torch.zeros_like(twist[..., :1])) - rest.rest_twist


def _joint_twist(twist: Twist) -> Twist:
    """Mean of the twist angles before and after each joint [rad]."""
    return 0.5 * (twist + torch.nn.functional.pad(twist[..., :-1], (1, 0)))


def rest_targets(direction: EdgeVectors, twist: Twist, rest: RodRest, rotation: RootRotations) -> EdgeVectors:
    """M_i r_i: where the rest shape points each edge."""
    tangent, normal = _frames_before(direction, rest, rotation)
    binormal = torch.linalg.cross(tangent, normal)
    middle = _joint_twist(twist)
    along, across, aside = rest.rest_direction.unbind(-1)
    cosine, sine = middle.cos(), middle.sin()
    return (
        along[..., None] * tangent
        + (across * cosine - aside * sine)[..., None] * normal
        + (across * sine + aside * cosine)[..., None] * binormal
    )


def _frames_before(direction: EdgeVectors, rest: RodRest, rotation: RootRotations) -> tuple[EdgeVectors, EdgeVectors]:
    """Tangent and normal of the frame F_(i-1) before each edge."""
    root = torch.einsum("bsij,skj->bski", rotation, rest.root_frame)
    tangent, normal = root[:, :, 0], root[:, :, 1]
    normals = transported_normals(tangent, normal, direction)
    before = torch.cat([tangent[:, :, None], direction[:, :, :-1]], dim=2)
    return before, torch.cat([normal[:, :, None], normals[:, :, :-1]], dim=2)


def equilibrium_twist(direction: EdgeVectors, rest: RodRest, rotation: RootRotations) -> Twist:
    """The angles phi that minimise the energy of given directions, by Newton's method from phi = 0 [rad].

    The bending energy of joint i is a constant less P_i cos + Q_i sin of the mean twist there, so the second derivative
    is tridiagonal. At first, where a joint is more than 67 degrees of twist from its own minimum, its curvature is
    raised (`SAFE_CURVATURE`); the last steps are plain Newton steps, none as large as `EXACT_BELOW`.
    """
    cosine_part, sine_part = _bending_by_twist(direction, rest, rotation)
    amplitude = torch.hypot(cosine_part, sine_part)
    twist, largest = torch.zeros_like(cosine_part), torch.full_like(cosine_part[..., :1], EXACT_BELOW)
    for _ in range(MOST_TWIST_STEPS):
        middle = _joint_twist(twist)
        cosine, sine = middle.cos(), middle.sin()
        bending = cosine_part * cosine + sine_part * sine
        safe = SAFE_CURVATURE * (0.5 * amplitude * (amplitude + bending).clamp(min=0)).sqrt()
        curvature = 0.25 * torch.where(largest < EXACT_BELOW, bending, torch.maximum(bending, safe))
        bent = 0.5 * (cosine_part * sine - sine_part * cosine)
        moment = rest.twisting_stiffness * twist_strain(twist, rest)
        step, least_pivot = _solve_tridiagonal(
            _sum_of_both_joints(curvature + rest.twisting_stiffness),
            curvature - rest.twisting_stiffness,
            bent + moment + torch.nn.functional.pad((bent - moment)[..., 1:], (0, 1)),
            rest.twisting_stiffness,
        )
        is_exact = largest < EXACT_BELOW
        # Where the exact system is not positive definite, or nearly singular, the next step is a safe one.
        size = step.abs().amax(dim=-1, keepdim=True)
        failed = is_exact & ((least_pivot < LEAST_PIVOT) | (size >= EXACT_BELOW))
        step = torch.where(failed | (largest < TWIST_TOLERANCE), 0, step)
        twist, largest = twist - step, step.abs().amax(dim=-1, keepdim=True)
        largest = torch.where(failed, EXACT_BELOW, largest)
        if float(largest.max()) < TWIST_TOLERANCE:
            break
    return twist


def _sum_of_both_joints(value: Twist) -> Twist:
    """Sum of what the joint before and the joint beyond each edge have; the last edge has none beyond."""
    return value + torch.nn.functional.pad(value[..., 1:], (0, 1))


def _bending_by_twist(direction: EdgeVectors, rest: RodRest, rotation: RootRotations) -> tuple[Twist, Twist]:
    """P and Q of every joint: its bending energy is a constant less P cos + Q sin of the twist at the joint."""
    tangent, normal = _frames_before(direction, rest, rotation)
    _, along_normal, along_binormal = in_frames(direction, tangent, normal).unbind(-1)
    _, across, aside = rest.rest_direction.unbind(-1)
    cosine_part = rest.bending_stiffness * (across * along_normal + aside * along_binormal)
    sine_part = rest.bending_stiffness * (across * along_binormal - aside * along_normal)
    return cosine_part, sine_part


def _solve_tridiagonal(
    diagonal: Twist, before: Twist, right: Twist, unit: Float[Tensor, "s e"]
) -> tuple[Twist, Float[Tensor, "b s 1"]]:
    """Solves a symmetric system whose entries between i - 1 and i are `before`[i]; its least pivot in `unit`."""
    pivots, rights = [diagonal[..., 0]], [right[..., 0]]
    for i in range(1, diagonal.shape[-1]):
        ratio = before[..., i] / pivots[-1]
        pivots.append(diagonal[..., i] - ratio * before[..., i])
        rights.append(right[..., i] - ratio * rights[-1])
    solution = [rights[-1] / pivots[-1]]
    for i in range(diagonal.shape[-1] - 2, -1, -1):
        solution.append((rights[i] - before[..., i + 1] * solution[-1]) / pivots[i])
    return torch.stack(solution[::-1], dim=-1), (torch.stack(pivots, dim=-1) / unit).amin(dim=-1, keepdim=True)
