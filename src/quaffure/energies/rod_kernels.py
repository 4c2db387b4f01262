"""The rod's energy (`quaffure.energies.rod`) compiled: value and gradient of every strand in one pass.

A strand goes through three loops over its edges, all in cache: root to tip, the frames are transported and the bending
energy is expanded in the twist angles; Newton's method finds these; tip to root, the energies are summed and the
adjoint of the transport is propagated. The same source serves float32 and float64.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.energies.known_gradient import with_gradient
from quaffure.energies.rod import (
    EXACT_BELOW,
    LEAST_ALIGNMENT,
    LEAST_PIVOT,
    MOST_TWIST_STEPS,
    SAFE_CURVATURE,
    TWIST_TOLERANCE,
    RodRest,
    RootRotations,
)
from quaffure.geometry.cell_list import check_finite, interleaved
from quaffure.types import Energy, Float, Positions, Tensor

Vector = tuple[Any, Any, Any]  # of scalars, float32 or float64
_RUN = 16  # strands that one thread takes in turn
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_LEAST_ALIGNMENT = np.float32(LEAST_ALIGNMENT)
_SAFE_CURVATURE = np.float32(SAFE_CURVATURE)
_TWIST_TOLERANCE, _EXACT_BELOW = np.float32(TWIST_TOLERANCE), np.float32(EXACT_BELOW)
_LEAST_PIVOT = np.float32(LEAST_PIVOT)
_LEAST_LENGTH = np.float32(1e-12)  # of an edge [m]: one without length has no direction and gets no force


class RodArrays(NamedTuple):
    """`RodRest` as kernels read it."""

    bending: np.ndarray
    twisting: np.ndarray
    rest_direction: np.ndarray
    rest_twist: np.ndarray
    root_frame: np.ndarray
    goal_weight: np.ndarray
    goal_direction: np.ndarray


class RodWorkspace(NamedTuple):
    """One strand on its way through the loops. Row 0 of frames and twist is the root's, row i + 1 that of edge i."""

    tangent: np.ndarray
    normal: np.ndarray
    inverse_length: np.ndarray
    twist: np.ndarray
    bending_by_twist: np.ndarray
    pivot: np.ndarray
    right: np.ndarray
    coupling: np.ndarray


def rod_arrays(rest: RodRest, dtype: torch.dtype = torch.float32) -> RodArrays:
    """The rest shape on the CPU in the dtype of the positions."""
    fields = (
        rest.bending_stiffness, rest.twisting_stiffness, rest.rest_direction, rest.rest_twist, rest.root_frame,
        rest.goal_weight, rest.goal_direction,
    )  # fmt: skip
    return RodArrays(*(field.detach().to("cpu", dtype).contiguous().numpy() for field in fields))


def fused_rod(positions: Positions, rest: RodArrays, rotation: RootRotations) -> Energy:
    """`energy_rod` [J] on the CPU, differentiable once in the positions alone.

    Args:
        positions: draped vertices [m], float32 or float64.
        rest: `rod_arrays` of the same groom and dtype.
        rotation: of every strand's scalp triangle from rest to the posed body.

    Raises:
        ValueError: a coordinate is not finite, or the gradient by the rotations is asked for.
    """
    check_finite(positions)
    if torch.is_grad_enabled() and rotation.requires_grad:
        raise ValueError("expected a body without gradient: `Backend.TORCH` differentiates it")
    energy, gradient = rod_energies_and_gradient(positions, rest, rotation)
    return with_gradient(positions, energy.double().sum(dim=1).to(positions), gradient)


def rod_energies_and_gradient(
    positions: Positions, rest: RodArrays, rotation: RootRotations
) -> tuple[Float[Tensor, "b s"], Positions]:
    """Energy of every strand [J] and its gradient by the positions [N]."""
    positions, rotation = positions.detach().contiguous(), rotation.detach().to(positions).contiguous()
    energy, gradient = positions.new_empty(positions.shape[:2]), torch.zeros_like(positions)
    _rods(positions.numpy(), rotation.numpy(), rest, get_num_threads(), energy.numpy(), gradient.numpy())
    return energy, gradient


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _rods(
    positions: np.ndarray, rotation: np.ndarray, rest: RodArrays, threads: int, energy: np.ndarray, gradient: np.ndarray
) -> None:
    batch, strands, vertices = positions.shape[:3]
    runs = (strands + _RUN - 1) // _RUN
    for index in prange(batch * runs + threads):
        item = interleaved(index, batch * runs, threads)
        if item >= batch * runs:
            continue
        sample = item // runs
        work = rod_workspace(vertices - 1, positions)
        for strand in range((item % runs) * _RUN, min(strands, (item % runs + 1) * _RUN)):
            energy[sample, strand] = rod_of_strand(
                positions[sample, strand], rotation[sample, strand], rest, strand, work, gradient[sample, strand]
            )


@njit(cache=True)
def rod_workspace(edges: int, like: np.ndarray) -> RodWorkspace:
    """An empty workspace for strands of so many edges, in the dtype of `like`."""
    dtype = like.dtype
    return RodWorkspace(
        np.empty((edges + 1, 3), dtype),
        np.empty((edges + 1, 3), dtype),
        np.empty(edges, dtype),
        np.empty(edges + 1, dtype),
        np.empty((edges, 2), dtype),
        np.empty(edges, dtype),
        np.empty(edges, dtype),
        np.empty(edges, dtype),
    )


# Inlined by LLVM: as a function of its own, it is compiled twice, alone and into `_rods`, with other roundings, and a
# process that compiles the kernels does not run the copy that one which loads them from the cache does.
@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def rod_of_strand(
    x: np.ndarray, rotation: np.ndarray, rest: RodArrays, strand: int, work: RodWorkspace, gradient: np.ndarray
) -> np.floating:
    """Energy of one strand [J]; its gradient by the vertices [N] is added to `gradient`."""
    transport_frames(x, rotation, rest, strand, work)
    solve_twist(rest, strand, work)
    return _energy_and_adjoint(rotation, rest, strand, work, gradient)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def rotate(rotation: np.ndarray, v: np.ndarray) -> Vector:
    """The matrix times the vector."""
    return (
        rotation[0, 0] * v[0] + rotation[0, 1] * v[1] + rotation[0, 2] * v[2],
        rotation[1, 0] * v[0] + rotation[1, 1] * v[1] + rotation[1, 2] * v[2],
        rotation[2, 0] * v[0] + rotation[2, 1] * v[1] + rotation[2, 2] * v[2],
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def transported(a: Vector, start: Vector, end: Vector) -> Vector:
    """A vector `a` across the unit vector `start`, rotated by the smallest rotation from `start` to the unit `end`."""
    w = dot(a, end) / max(_ONE + dot(start, end), _LEAST_ALIGNMENT)
    return a[0] - w * (start[0] + end[0]), a[1] - w * (start[1] + end[1]), a[2] - w * (start[2] + end[2])


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def transported_adjoint(a: Vector, start: Vector, end: Vector, upstream: Vector) -> tuple[Vector, Vector, Vector]:
    """Gradients of upstream . transported(a, start, end) by a, start and end."""
    alignment = _ONE + dot(start, end)
    inverse = _ONE / max(alignment, _LEAST_ALIGNMENT)
    w = dot(a, end) * inverse
    by_w = -(dot(upstream, start) + dot(upstream, end))
    by_dot = by_w * inverse
    by_alignment = -by_w * w * inverse if alignment > _LEAST_ALIGNMENT else _ZERO
    by_a = (upstream[0] + by_dot * end[0], upstream[1] + by_dot * end[1], upstream[2] + by_dot * end[2])
    by_start = (
        by_alignment * end[0] - w * upstream[0],
        by_alignment * end[1] - w * upstream[1],
        by_alignment * end[2] - w * upstream[2],
    )
    by_end = (
        by_dot * a[0] + by_alignment * start[0] - w * upstream[0],
        by_dot * a[1] + by_alignment * start[1] - w * upstream[1],
        by_dot * a[2] + by_alignment * start[2] - w * upstream[2],
    )
    return by_a, by_start, by_end


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _store(array: np.ndarray, row: int, v: Vector) -> None:
    array[row, 0], array[row, 1], array[row, 2] = v[0], v[1], v[2]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _load(array: np.ndarray, row: int) -> Vector:
    return array[row, 0], array[row, 1], array[row, 2]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def transport_frames(x: np.ndarray, rotation: np.ndarray, rest: RodArrays, strand: int, work: RodWorkspace) -> None:
    """Directions of the edges, frames F, and P and Q of the bending energy by twist, -P cos(phi) - Q sin(phi)."""
    t = rotate(rotation, rest.root_frame[strand, 0])
    a = rotate(rotation, rest.root_frame[strand, 1])
    _store(work.tangent, 0, t)
    _store(work.normal, 0, a)
    for edge in range(len(x) - 1):
        e = (x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1], x[edge + 1, 2] - x[edge, 2])
        inverse = _ONE / max(np.sqrt(dot(e, e)), _LEAST_LENGTH)
        u = (inverse * e[0], inverse * e[1], inverse * e[2])
        along_normal, along_binormal = dot(u, a), dot(u, cross(t, a))
        across, aside = rest.rest_direction[strand, edge, 1], rest.rest_direction[strand, edge, 2]
        stiffness = rest.bending[strand, edge]
        work.bending_by_twist[edge, 0] = stiffness * (across * along_normal + aside * along_binormal)
        work.bending_by_twist[edge, 1] = stiffness * (across * along_binormal - aside * along_normal)
        a = transported(a, t, u)
        t = u
        work.inverse_length[edge] = inverse
        _store(work.tangent, edge + 1, t)
        _store(work.normal, edge + 1, a)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def solve_twist(rest: RodArrays, strand: int, work: RodWorkspace) -> None:
    """Newton's method for the twist angles from zero, as in `equilibrium_twist`."""
    work.twist[:] = _ZERO
    step = _EXACT_BELOW
    for _ in range(MOST_TWIST_STEPS):
        step = _twist_step(rest, strand, work, bool(step < _EXACT_BELOW))
        if step < _TWIST_TOLERANCE:
            break


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _joint_derivatives(
    rest: RodArrays, strand: int, work: RodWorkspace, joint: int, is_exact: bool
) -> tuple[Any, Any, Any, Any]:
    """Half the slope and a quarter of the curvature of a joint's energy by the mean of its two twist angles; its twist
    moment and twisting stiffness. A curvature that is not exact is safe."""
    angle, beyond = work.twist[joint], work.twist[joint + 1]
    middle = _HALF * (angle + beyond)
    cosine, sine = np.cos(middle), np.sin(middle)
    p, q = work.bending_by_twist[joint, 0], work.bending_by_twist[joint, 1]
    curvature = p * cosine + q * sine
    if not is_exact:
        amplitude = np.sqrt(p * p + q * q)
        curvature = max(curvature, _SAFE_CURVATURE * np.sqrt(_HALF * amplitude * max(amplitude + curvature, _ZERO)))
    stiffness = rest.twisting[strand, joint]
    moment = stiffness * (beyond - angle - rest.rest_twist[strand, joint])
    return _HALF * (p * sine - q * cosine), _HALF * _HALF * curvature, moment, stiffness


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _twist_step(rest: RodArrays, strand: int, work: RodWorkspace, is_exact: bool) -> np.floating:
    """One step of Newton's method: elimination from root to tip, substitution back. Returns the largest change.

    Where the exact system is not positive definite, or nearly singular, nothing changes; the next step is a safe one.
    """
    twist, pivot, right, coupling = work.twist, work.pivot, work.right, work.coupling
    edges = len(pivot)
    slope, curvature, moment, stiffness = _joint_derivatives(rest, strand, work, 0, is_exact)
    pivot_before, right_before = _ONE, _ZERO
    for edge in range(edges):
        # Edge -1 is the root, which has no twist.
        between = curvature - stiffness if edge > 0 else _ZERO
        diagonal, total = curvature + stiffness, slope + moment
        if edge + 1 < edges:
            slope, curvature, moment, stiffness = _joint_derivatives(rest, strand, work, edge + 1, is_exact)
            diagonal += curvature + stiffness
            total += slope - moment
        ratio = between / pivot_before
        pivot_before = diagonal - ratio * between
        if is_exact and pivot_before < _LEAST_PIVOT * rest.twisting[strand, edge]:
            return _EXACT_BELOW
        right_before = total - ratio * right_before
        pivot[edge], right[edge], coupling[edge] = pivot_before, right_before, between
    step, largest = _ZERO, _ZERO
    for edge in range(edges - 1, -1, -1):
        beyond = coupling[edge + 1] if edge + 1 < edges else _ZERO
        step = (right[edge] - beyond * step) / pivot[edge]
        largest = max(largest, abs(step))
        right[edge] = step
    if is_exact and not largest < _EXACT_BELOW:
        return _EXACT_BELOW
    for edge in range(edges):
        twist[edge + 1] -= right[edge]
    return largest


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def bend_joint(
    t: Vector,
    a: Vector,
    u: Vector,
    r: Vector,
    cosine: float,
    sine: float,
    stiffness: float,
) -> tuple[Any, Vector, Vector, Vector]:
    """Bending energy before an edge of direction u and its gradients by the frame's tangent t and normal a, and by u.

    B / 2 |u - M r|^2 with M r = r_0 t + (r_1 cos - r_2 sin) a + (r_1 sin + r_2 cos) t x a.
    """
    b = cross(t, a)
    on_a, on_b = r[1] * cosine - r[2] * sine, r[1] * sine + r[2] * cosine
    sx = u[0] - r[0] * t[0] - on_a * a[0] - on_b * b[0]
    sy = u[1] - r[0] * t[1] - on_a * a[1] - on_b * b[1]
    sz = u[2] - r[0] * t[2] - on_a * a[2] - on_b * b[2]
    f = (stiffness * sx, stiffness * sy, stiffness * sz)
    by_b = (-on_b * f[0], -on_b * f[1], -on_b * f[2])
    a_b, b_t = cross(a, by_b), cross(by_b, t)
    by_t = (a_b[0] - r[0] * f[0], a_b[1] - r[0] * f[1], a_b[2] - r[0] * f[2])
    by_a = (b_t[0] - on_a * f[0], b_t[1] - on_a * f[1], b_t[2] - on_a * f[2])
    return _HALF * stiffness * (sx * sx + sy * sy + sz * sz), by_t, by_a, f


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _energy_and_adjoint(
    rotation: np.ndarray, rest: RodArrays, strand: int, work: RodWorkspace, gradient: np.ndarray
) -> np.floating:
    """Energy, and from tip to root the gradient by directions and frames, passed on to the vertices."""
    energy = _ZERO
    upstream = (_ZERO, _ZERO, _ZERO)  # gradient by the normal of this edge's frame
    carry = (_ZERO, _ZERO, _ZERO)  # gradient by this edge's direction from all joints beyond
    for edge in range(len(work.pivot) - 1, -1, -1):
        t, u = _load(work.tangent, edge), _load(work.tangent, edge + 1)
        a = _load(work.normal, edge)
        angle = _HALF * (work.twist[edge] + work.twist[edge + 1])
        bent, by_t, by_a, by_u = bend_joint(
            t, a, u, _load(rest.rest_direction[strand], edge), np.cos(angle), np.sin(angle), rest.bending[strand, edge]
        )
        strain = work.twist[edge + 1] - work.twist[edge] - rest.rest_twist[strand, edge]
        energy += bent + _HALF * rest.twisting[strand, edge] * strain * strain
        frame_a, frame_t, frame_u = transported_adjoint(a, t, u, upstream)
        gx, gy, gz = by_u[0] + frame_u[0] + carry[0], by_u[1] + frame_u[1] + carry[1], by_u[2] + frame_u[2] + carry[2]
        weight = rest.goal_weight[strand, edge]
        if weight > _ZERO:
            goal = rotate(rotation, rest.goal_direction[strand, edge])
            sx, sy, sz = u[0] - goal[0], u[1] - goal[1], u[2] - goal[2]
            energy += _HALF * weight * (sx * sx + sy * sy + sz * sz)
            gx, gy, gz = gx + weight * sx, gy + weight * sy, gz + weight * sz
        _add_to_vertices(gradient, edge, u, (gx, gy, gz), work.inverse_length[edge])
        upstream = (by_a[0] + frame_a[0], by_a[1] + frame_a[1], by_a[2] + frame_a[2])
        carry = (by_t[0] + frame_t[0], by_t[1] + frame_t[1], by_t[2] + frame_t[2])
    return energy


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _add_to_vertices(gradient: np.ndarray, edge: int, u: Vector, by_u: Vector, inverse_length: float) -> None:
    """Gradient by an edge's direction as one by its two ends: only its part across the edge counts."""
    along = dot(u, by_u)
    for axis in range(3):
        force = inverse_length * (by_u[axis] - along * u[axis])
        gradient[edge, axis] -= force
        gradient[edge + 1, axis] += force
