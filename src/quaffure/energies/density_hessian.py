"""Eqs. 11-13 in double precision with products of their Hessian, from a list of the pairs that matter.

Value and gradient are those of `quaffure.energies.fused_density`, the twin in single precision. Arrays "in the crowd's
order" follow the cells of a grid, so that neighbours lie together in memory.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange

from quaffure.geometry.neighbors import cell_columns, sort_into_cells


class Crowd(NamedTuple):
    """All vertices of a groom in the order of the cells of a grid as wide as the kernel's support.

    Attributes:
        x, y, z: positions [m].
        mass: [kg].
        order: place in the groom of every vertex.
        start: where each cell starts.
        shape: cells along x, y, z.
        smoothing_length: h [m].
    """

    x: Float[np.ndarray, " p"]
    y: Float[np.ndarray, " p"]
    z: Float[np.ndarray, " p"]
    mass: Float[np.ndarray, " p"]
    order: Int[np.ndarray, " p"]
    start: Int[np.ndarray, " c"]
    shape: tuple[int, int, int]
    smoothing_length: float


class Pressed(NamedTuple):
    """Pairs of vertices that push each other, each pair from both of its sides, in the crowd's order.

    Attributes:
        first: where the pairs of each vertex start; one more entry than vertices.
        other: the vertex across.
        slope: gradient of the kernel W by the vertex itself [1/m^4].
        across, along: the pair's own Hessian is `across` I + `along` slope slope^T [N/m, N m^7].
        mass: of every vertex [kg].
        stiffness: second derivative of the energy by every vertex's density [J m^6/kg^2].
    """

    first: Int[np.ndarray, " q"]
    other: Int[np.ndarray, " m"]
    slope: Float[np.ndarray, "m 3"]
    across: Float[np.ndarray, " m"]
    along: Float[np.ndarray, " m"]
    mass: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " p"]


def crowd_of(points: Float[np.ndarray, "p 3"], mass: Float[np.ndarray, " p"], smoothing_length: float) -> Crowd:
    """Vertices [m] of masses [kg], sorted into cells."""
    order, start, shape = sort_into_cells(points, np.float32(2 * smoothing_length))
    x, y, z = np.ascontiguousarray(points[order].T)
    return Crowd(x, y, z, mass[order], order, start, shape, smoothing_length)


def density(crowd: Crowd) -> Float[np.ndarray, " p"]:
    """Eq. 12 of every vertex in the crowd's order [kg/m^3]."""
    found = np.empty(len(crowd.order))
    _densities(crowd.x, crowd.y, crowd.z, crowd.mass, crowd.start, crowd.shape, crowd.smoothing_length, found)
    return found


def pressed(
    crowd: Crowd, slope: Float[np.ndarray, " p"], stiffness: Float[np.ndarray, " p"], repulsion: float | None = None
) -> Pressed:
    """Pairs of which one at least has stiffness; the rest does not enter the Hessian.

    Args:
        slope: derivative of the energy by every density, not negative [J m^3/kg].
        stiffness: the second derivative, not negative.
        repulsion: share of the pairs' own Hessian kept where it is positive; where it is negative all is left out, so
            that the sum has no negative eigenvalue; None for the exact Hessian.
    """
    first = np.zeros(len(crowd.order) + 1, np.int64)
    geometry = (crowd.x, crowd.y, crowd.z, crowd.start, crowd.shape, crowd.smoothing_length)
    _count(*geometry, stiffness, first)
    first = np.cumsum(first)
    others, slopes = np.empty(first[-1], np.int32), np.empty((first[-1], 3), np.float32)
    across, along = np.empty(first[-1], np.float32), np.empty(first[-1], np.float32)
    kept = -1.0 if repulsion is None else repulsion
    _list(*geometry, crowd.mass, slope, stiffness, kept, first, others, slopes, across, along)
    return Pressed(first, others, slopes, across, along, crowd.mass, stiffness)


def density_change(pairs: Pressed, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
    """First-order change of every density that has stiffness along a step [m], 0 of the others [kg/m^3]."""
    change = np.empty(len(step))
    _change(pairs.first, pairs.other, pairs.slope, pairs.mass, pairs.stiffness, step, change)
    return change


def density_force(pairs: Pressed, slope: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """Gradient [N] of an energy whose derivative by every density is `slope` [J m^3/kg]."""
    force = np.empty((len(slope), 3))
    _force(pairs.first, pairs.other, pairs.slope, pairs.mass, slope, force)
    return force


def density_product(pairs: Pressed, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    """The Hessian times a step [m]: [N]."""
    change = pairs.stiffness * density_change(pairs, step)
    product = np.empty_like(step)
    _multiply(pairs.first, pairs.other, pairs.slope, pairs.across, pairs.along, pairs.mass, change, step, product)
    return product


def density_blocks(pairs: Pressed) -> Float[np.ndarray, "p 3 3"]:
    """Blocks of the Hessian on each vertex [N/m]."""
    blocks = np.empty((len(pairs.mass), 3, 3))
    _blocks(*pairs, blocks)
    return blocks


@njit(cache=True, parallel=True, fastmath=True)
def _densities(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, mass: np.ndarray, start: np.ndarray,
    shape: tuple[int, int, int], h: float, density: np.ndarray,
) -> None:  # fmt: skip
    scale, inverse = 1.0 / (4.0 * math.pi * h**3), 1.0 / h
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for place in range(start[cell], start[cell + 1]):
            px, py, pz = x[place], y[place], z[place]
            total = 0.0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses = x[near_by], y[near_by], z[near_by], mass[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    q = np.sqrt(dx * dx + dy * dy + dz * dz) * inverse
                    far, near = max(2.0 - q, 0.0), max(1.0 - q, 0.0)
                    total += masses[other] * (far * far * far - 4.0 * near * near * near)
            density[place] = total * scale


@njit(cache=True, parallel=True, fastmath=True)
def _count(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, start: np.ndarray, shape: tuple[int, int, int], h: float,
    stiffness: np.ndarray, counts: np.ndarray,
) -> None:  # fmt: skip
    reach = 4.0 * h * h
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for place in range(start[cell], start[cell + 1]):
            px, py, pz, own = x[place], y[place], z[place], stiffness[place]
            count = 0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, others = x[near_by], y[near_by], z[near_by], stiffness[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    close = dx * dx + dy * dy + dz * dz < reach
                    count += close and own + others[other] > 0.0
            counts[place + 1] = count


@njit(cache=True, parallel=True, fastmath=True)
def _list(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, start: np.ndarray, shape: tuple[int, int, int], h: float,
    mass: np.ndarray, energy_slope: np.ndarray, stiffness: np.ndarray, repulsion: float, first: np.ndarray,
    others: np.ndarray, slopes: np.ndarray, acrosses: np.ndarray, alongs: np.ndarray,
) -> None:  # fmt: skip
    """`repulsion` below zero asks for the exact Hessian."""
    reach, inverse, scale = 4.0 * h * h, 1.0 / h, 3.0 / (4.0 * math.pi * h**4)
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for place in range(start[cell], start[cell + 1]):
            at = first[place]
            for column in range(found):
                for other in range(ranges[column, 0], ranges[column, 1]):
                    dx, dy, dz = x[place] - x[other], y[place] - y[other], z[place] - z[other]
                    squared = dx * dx + dy * dy + dz * dz
                    if squared >= reach or stiffness[place] + stiffness[other] <= 0.0:
                        continue
                    r = max(np.sqrt(squared), 1e-9)
                    far, near = 2.0 - r * inverse, max(1.0 - r * inverse, 0.0)
                    fall = scale * (4.0 * near * near - far * far)
                    bend = scale * inverse * (2.0 * far - 8.0 * near)
                    others[at] = other
                    slopes[at, 0], slopes[at, 1], slopes[at, 2] = fall * dx / r, fall * dy / r, fall * dz / r
                    push = energy_slope[place] * mass[other] + energy_slope[other] * mass[place]
                    across = push * fall / r
                    if repulsion >= 0.0:
                        across, bend = 0.0, repulsion * max(bend, 0.0)
                    # A vertex is its own neighbour too, at no distance.
                    acrosses[at] = across if place != other else 0.0
                    alongs[at] = (push * bend - across) / max(fall * fall, 1e-30) if place != other else 0.0
                    at += 1


@njit(cache=True, parallel=True, fastmath=True)
def _force(
    first: np.ndarray, others: np.ndarray, slopes: np.ndarray, mass: np.ndarray, energy_slope: np.ndarray,
    force: np.ndarray,
) -> None:  # fmt: skip
    for place in prange(len(mass)):
        fx, fy, fz = 0.0, 0.0, 0.0
        own_mass, own_slope = mass[place], energy_slope[place]
        for at in range(first[place], first[place + 1]):
            other = others[at]
            push = own_slope * mass[other] + energy_slope[other] * own_mass
            fx += push * slopes[at, 0]
            fy += push * slopes[at, 1]
            fz += push * slopes[at, 2]
        force[place, 0], force[place, 1], force[place, 2] = fx, fy, fz


@njit(cache=True, parallel=True, fastmath=True)
def _change(
    first: np.ndarray, others: np.ndarray, slopes: np.ndarray, mass: np.ndarray, stiffness: np.ndarray,
    step: np.ndarray, change: np.ndarray,
) -> None:  # fmt: skip
    for place in prange(len(mass)):
        change[place] = 0.0
        if stiffness[place] <= 0.0:
            continue
        total = 0.0
        sx, sy, sz = step[place, 0], step[place, 1], step[place, 2]
        for at in range(first[place], first[place + 1]):
            other = others[at]
            total += mass[other] * (
                slopes[at, 0] * (sx - step[other, 0])
                + slopes[at, 1] * (sy - step[other, 1])
                + slopes[at, 2] * (sz - step[other, 2])
            )
        change[place] = total


@njit(cache=True, parallel=True, fastmath=True)
def _multiply(
    first: np.ndarray, others: np.ndarray, slopes: np.ndarray, across: np.ndarray, along: np.ndarray,
    mass: np.ndarray, change: np.ndarray, step: np.ndarray, product: np.ndarray,
) -> None:  # fmt: skip
    for place in prange(len(mass)):
        fx, fy, fz = 0.0, 0.0, 0.0
        sx, sy, sz = step[place, 0], step[place, 1], step[place, 2]
        own_mass, own_change = mass[place], change[place]
        for at in range(first[place], first[place + 1]):
            other = others[at]
            dx, dy, dz = sx - step[other, 0], sy - step[other, 1], sz - step[other, 2]
            gx, gy, gz = slopes[at, 0], slopes[at, 1], slopes[at, 2]
            push = own_change * mass[other] + change[other] * own_mass
            push += along[at] * (gx * dx + gy * dy + gz * dz)
            fx += push * gx + across[at] * dx
            fy += push * gy + across[at] * dy
            fz += push * gz + across[at] * dz
        product[place, 0], product[place, 1], product[place, 2] = fx, fy, fz


@njit(cache=True, parallel=True, fastmath=True)
def _blocks(
    first: np.ndarray, others: np.ndarray, slopes: np.ndarray, across: np.ndarray, along: np.ndarray,
    mass: np.ndarray, stiffness: np.ndarray, blocks: np.ndarray,
) -> None:  # fmt: skip
    for place in prange(len(mass)):
        block = np.zeros((3, 3))
        ox, oy, oz = 0.0, 0.0, 0.0
        for at in range(first[place], first[place + 1]):
            other = others[at]
            gx, gy, gz = slopes[at, 0], slopes[at, 1], slopes[at, 2]
            ox += mass[other] * gx
            oy += mass[other] * gy
            oz += mass[other] * gz
            weight = stiffness[other] * mass[place] * mass[place] + along[at]
            block[0, 0] += weight * gx * gx + across[at]
            block[0, 1] += weight * gx * gy
            block[0, 2] += weight * gx * gz
            block[1, 1] += weight * gy * gy + across[at]
            block[1, 2] += weight * gy * gz
            block[2, 2] += weight * gz * gz + across[at]
        own = stiffness[place]
        block[0, 0] += own * ox * ox
        block[0, 1] += own * ox * oy
        block[0, 2] += own * ox * oz
        block[1, 1] += own * oy * oy
        block[1, 2] += own * oy * oz
        block[2, 2] += own * oz * oz
        block[1, 0], block[2, 0], block[2, 1] = block[0, 1], block[0, 2], block[1, 2]
        blocks[place] = block
