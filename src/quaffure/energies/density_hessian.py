"""Eqs. 11-13 in double precision with products of their Hessian, from a list of the pairs that matter.

Value and gradient are those of `quaffure.energies.fused_density`, the twin in single precision. Arrays "in the crowd's
order" follow the cells of a grid, so that neighbours lie together in memory.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit, prange

from quaffure.energies.fused_density import Particles
from quaffure.geometry.neighbors import Grid, cell_columns, grid_round, sort_into_grid

REPULSION = 0.15
"""Share of the pairs' own Hessian in the convex one: all of it is too stiff without the negative rest."""


class Crowd(NamedTuple):
    """Vertices in the order of the cells of a grid as wide as the kernel's support.

    Attributes:
        x, y, z: positions [m].
        mass: [kg].
        order: place in the groom of every vertex.
        start: where each cell starts.
        grid: the cells.
        smoothing_length: h [m].
    """

    x: Float[np.ndarray, " p"]
    y: Float[np.ndarray, " p"]
    z: Float[np.ndarray, " p"]
    mass: Float[np.ndarray, " p"]
    order: Int[np.ndarray, " p"]
    start: Int[np.ndarray, " c"]
    grid: Grid
    smoothing_length: float

    @property
    def particles(self) -> Particles:
        """Positions and masses, as kernels read them."""
        return Particles(self.x, self.y, self.z, self.mass, self.start)

    def of(self, kept: Bool[np.ndarray, " p"]) -> "Crowd":
        """Some of the vertices, picked in the crowd's order."""
        start = np.concatenate([[0], np.cumsum(kept)])[self.start]
        x, y, z, mass, order = (field[kept] for field in self[:5])
        return Crowd(x, y, z, mass, order, start, self.grid, self.smoothing_length)


class Pressed(NamedTuple):
    """Pairs of vertices that push each other, each pair from both of its sides, in the crowd's order.

    Rows are the vertices that move, then those beside them that do not, which list only those that move.

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


def crowd_of(
    points: Float[np.ndarray, "p 3"], mass: Float[np.ndarray, " p"], smoothing_length: float, grid: Grid | None = None
) -> Crowd:
    """Vertices [m] of masses [kg], sorted into cells: those of `grid`, or of one round them."""
    grid = grid or grid_round(points, np.float32(2 * smoothing_length))
    order, start = sort_into_grid(points, grid)
    x, y, z = np.ascontiguousarray(points[order].T)
    return Crowd(x, y, z, mass[order], order, start, grid, smoothing_length)


def density(crowd: Crowd, others: Crowd | None = None) -> Float[np.ndarray, " p"]:
    """Eq. 12 of every vertex in the crowd's order [kg/m^3]; `others`, in the same grid: what they alone bring."""
    found = np.empty(len(crowd.order))
    near_by = (others or crowd).particles
    _densities(crowd.particles, near_by, crowd.grid.shape, crowd.smoothing_length, found)
    return found


def pressed(
    crowd: Crowd,
    slope: Float[np.ndarray, " q"],
    stiffness: Float[np.ndarray, " q"],
    exactness: float = 1.0,
    beside: Crowd | None = None,
) -> Pressed:
    """Pairs of which one at least has stiffness; the rest does not enter the Hessian.

    Args:
        slope: derivative of the energy by every density, not negative [J m^3/kg]; those `beside` last.
        stiffness: the second derivative, not negative.
        exactness: 1 for the exact Hessian, 0 for a convex one, and shares of both in between. In the convex one a pair
            keeps `REPULSION` of its own Hessian along the line between its vertices where that is positive.
        beside: vertices in the same grid that do not move.
    """
    split = len(crowd.order)
    blocks = [(crowd, slice(0, split), crowd, slice(0, split))]
    if beside is not None:
        resting = slice(split, split + len(beside.order))
        blocks += [(crowd, slice(0, split), beside, resting), (beside, resting, crowd, slice(0, split))]
    counts = np.zeros(len(slope), np.int64)
    for rows, where, others, there in blocks:
        pair = (rows.particles, others.particles, crowd.grid.shape, crowd.smoothing_length)
        _count(*pair, stiffness[where], stiffness[there], counts[where])
    first = np.concatenate([[0], np.cumsum(counts)])
    other, slopes = np.empty(first[-1], np.int32), np.empty((first[-1], 3), np.float32)
    across, along = np.empty(first[-1], np.float32), np.empty(first[-1], np.float32)
    at = first[:-1].copy()
    for rows, where, others, there in blocks:
        pair = (rows.particles, others.particles, crowd.grid.shape, crowd.smoothing_length)
        derivatives = (slope[where], slope[there], stiffness[where], stiffness[there])
        _list(*pair, *derivatives, exactness, there.start, at[where], other, slopes, across, along)
    mass = crowd.mass if beside is None else np.concatenate([crowd.mass, beside.mass])
    return Pressed(first, other, slopes, across, along, mass, stiffness)


def density_gradient(crowd: Crowd, slope: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """Gradient [N] of an energy whose derivative by every density is `slope` [J m^3/kg], without a list of pairs."""
    gradient = np.empty((len(slope), 3))
    _gradient(crowd.particles, crowd.grid.shape, crowd.smoothing_length, slope, gradient)
    return gradient


def density_change(pairs: Pressed, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " q"]:
    """First-order change of every density that has stiffness along a step [m], 0 of the others [kg/m^3].

    Vertices beyond those that `step` holds do not move.
    """
    change = np.empty(len(pairs.mass))
    _change(pairs.first, pairs.other, pairs.slope, pairs.mass, pairs.stiffness, _padded(pairs, step), change)
    return change


def density_force(
    pairs: Pressed, slope: Float[np.ndarray, " q"], moving: int | None = None
) -> Float[np.ndarray, "p 3"]:
    """Gradient [N] of an energy whose derivative by every density is `slope` [J m^3/kg], by the first `moving`."""
    force = np.empty((len(slope) if moving is None else moving, 3))
    _force(pairs.first, pairs.other, pairs.slope, pairs.mass, slope, force)
    return force


def density_product(pairs: Pressed, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    """The Hessian times a step [m] of those that move: [N]."""
    change, product, step_of_all = np.empty(len(pairs.mass)), np.empty_like(step), _padded(pairs, step)
    _change(pairs.first, pairs.other, pairs.slope, pairs.mass, pairs.stiffness, step_of_all, change)
    change *= pairs.stiffness
    _multiply(
        pairs.first, pairs.other, pairs.slope, pairs.across, pairs.along, pairs.mass, change, step_of_all, product
    )
    return product


def density_blocks(pairs: Pressed, moving: int | None = None) -> Float[np.ndarray, "p 3 3"]:
    """Blocks of the Hessian on each of the first `moving` vertices [N/m]."""
    blocks = np.empty((len(pairs.mass) if moving is None else moving, 3, 3))
    _blocks(*pairs, blocks)
    return blocks


def _padded(pairs: Pressed, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "q 3"]:
    if len(step) == len(pairs.mass):
        return step
    padded = np.zeros((len(pairs.mass), 3))
    padded[: len(step)] = step
    return padded


@njit(cache=True, parallel=True, fastmath=True)
def _densities(rows: Particles, others: Particles, shape: tuple[int, int, int], h: float, density: np.ndarray) -> None:
    scale, inverse = 1.0 / (4.0 * math.pi * h**3), 1.0 / h
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, others.start, ranges)
        for place in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz = rows.x[place], rows.y[place], rows.z[place]
            total = 0.0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses = others.x[near_by], others.y[near_by], others.z[near_by], others.weight[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    q = np.sqrt(dx * dx + dy * dy + dz * dz) * inverse
                    far, near = max(2.0 - q, 0.0), max(1.0 - q, 0.0)
                    total += masses[other] * (far * far * far - 4.0 * near * near * near)
            density[place] = total * scale


@njit(cache=True, parallel=True, fastmath=True)
def _gradient(rows: Particles, shape: tuple[int, int, int], h: float, slope: np.ndarray, gradient: np.ndarray) -> None:
    scale, inverse = 3.0 / (4.0 * math.pi * h**4), 1.0 / h
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, rows.start, ranges)
        for place in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz = rows.x[place], rows.y[place], rows.z[place]
            own_slope, own_mass = scale * slope[place], scale * rows.weight[place]
            gx, gy, gz = 0.0, 0.0, 0.0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses, slopes = (
                    rows.x[near_by], rows.y[near_by], rows.z[near_by], rows.weight[near_by], slope[near_by]
                )  # fmt: skip
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    far, near = max(2.0 - r * inverse, 0.0), max(1.0 - r * inverse, 0.0)
                    push = own_slope * masses[other] + own_mass * slopes[other]
                    push *= (4.0 * near * near - far * far) / max(r, 1e-9)
                    gx += push * dx
                    gy += push * dy
                    gz += push * dz
            gradient[place, 0], gradient[place, 1], gradient[place, 2] = gx, gy, gz


@njit(cache=True, parallel=True, fastmath=True)
def _count(
    rows: Particles, others: Particles, shape: tuple[int, int, int], h: float, own_stiffness: np.ndarray,
    stiffness: np.ndarray, counts: np.ndarray,
) -> None:  # fmt: skip
    """Add the number of pairs of every row to `counts`."""
    reach = 4.0 * h * h
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, others.start, ranges)
        for place in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz, own = rows.x[place], rows.y[place], rows.z[place], own_stiffness[place]
            count = 0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, theirs = others.x[near_by], others.y[near_by], others.z[near_by], stiffness[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    count += (dx * dx + dy * dy + dz * dz < reach) & (own + theirs[other] > 0.0)
            counts[place] += count


@njit(cache=True, parallel=True, fastmath=True)
def _list(
    rows: Particles, near_by: Particles, shape: tuple[int, int, int], h: float, own_slope: np.ndarray,
    energy_slope: np.ndarray, own_stiffness: np.ndarray, stiffness: np.ndarray, exactness: float, offset: int,
    cursor: np.ndarray, others: np.ndarray, slopes: np.ndarray, acrosses: np.ndarray, alongs: np.ndarray,
) -> None:  # fmt: skip
    """Write the pairs of every row from its `cursor` on, and move that behind them.

    Args:
        offset: index of the first of those near by among all.
    """
    reach, inverse, scale = 4.0 * h * h, 1.0 / h, 3.0 / (4.0 * math.pi * h**4)
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, near_by.start, ranges)
        candidates = 1
        for column in range(found):
            candidates += ranges[column, 1] - ranges[column, 0]
        kept = np.empty(candidates, np.int32)
        for place in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz, own = rows.x[place], rows.y[place], rows.z[place], own_stiffness[place]
            count = 0
            for column in range(found):
                for other in range(ranges[column, 0], ranges[column, 1]):
                    dx, dy, dz = px - near_by.x[other], py - near_by.y[other], pz - near_by.z[other]
                    # No branch: most are too far away, and which cannot be foreseen.
                    kept[count] = other
                    count += (dx * dx + dy * dy + dz * dz < reach) & (own + stiffness[other] > 0.0)
            at, mass = cursor[place], rows.weight[place]
            for other in kept[:count]:
                dx, dy, dz = px - near_by.x[other], py - near_by.y[other], pz - near_by.z[other]
                squared = dx * dx + dy * dy + dz * dz
                r = max(np.sqrt(squared), 1e-9)
                away = 1.0 / r
                far, near = 2.0 - r * inverse, max(1.0 - r * inverse, 0.0)
                fall = scale * (4.0 * near * near - far * far)
                bend = scale * inverse * (2.0 * far - 8.0 * near)
                unit = fall * away
                others[at] = offset + other
                slopes[at, 0], slopes[at, 1], slopes[at, 2] = unit * dx, unit * dy, unit * dz
                push = own_slope[place] * near_by.weight[other] + energy_slope[other] * mass
                across = exactness * push * unit
                bend = exactness * bend + (1.0 - exactness) * REPULSION * max(bend, 0.0)
                # A vertex is its own neighbour too, at no distance.
                acrosses[at] = across if squared > 0.0 else 0.0
                alongs[at] = (push * bend - across) / max(fall * fall, 1e-30) if squared > 0.0 else 0.0
                at += 1
            cursor[place] = at


@njit(cache=True, parallel=True, fastmath=True)
def _force(
    first: np.ndarray, others: np.ndarray, slopes: np.ndarray, mass: np.ndarray, energy_slope: np.ndarray,
    force: np.ndarray,
) -> None:  # fmt: skip
    for place in prange(len(force)):
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
    for place in prange(len(product)):
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
    for place in prange(len(blocks)):
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
