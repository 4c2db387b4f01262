"""The pairs of vertices that enter the Hessian of Eq. 11, listed once for many products (`density_hessian`)."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange

from quaffure.energies.fused_density import Particles
from quaffure.energies.smoothing_kernel import kernel_slope
from quaffure.geometry.cell_list import cell_columns
from quaffure.solvers.newton.density_particles import DensityParticles

REPULSION = 0.15
"""Share of the pairs' own Hessian in the convex one: all of it is too stiff without the negative rest."""
RIM = 1.0 - 1e-6
"""Share of the kernel's squared support within which pairs are listed. At the rim itself nothing is pushed and `along`
has no bound. And whatever is listed was counted: two loops may round one comparison differently."""


class PressedPairs(NamedTuple):
    """Pairs of vertices that push each other, each pair from both of its sides, in the sorted order.

    Rows are the vertices that move, then their neighbours that do not, which list only those that move.

    Attributes:
        first: where the pairs of each vertex start; one more entry than vertices.
        other: the vertex across.
        kernel_gradient: of W, by the vertex itself [1/m^4].
        across, along: the pair's own Hessian is `across` I + `along` g g^T, g that gradient [N/m, N m^7].
        mass: of every vertex [kg].
        stiffness: second derivative of the energy by every vertex's density [J m^6/kg^2].
    """

    first: Int[np.ndarray, " q"]
    other: Int[np.ndarray, " m"]
    kernel_gradient: Float[np.ndarray, "m 3"]
    across: Float[np.ndarray, " m"]
    along: Float[np.ndarray, " m"]
    mass: Float[np.ndarray, " p"]
    stiffness: Float[np.ndarray, " p"]


def pressed_pairs(
    particles: DensityParticles,
    pressure: Float[np.ndarray, " q"],
    stiffness: Float[np.ndarray, " q"],
    exactness: float = 1.0,
    fixed: DensityParticles | None = None,
) -> PressedPairs:
    """Pairs of which one at least has stiffness; the rest does not enter the Hessian.

    Args:
        pressure: derivative of the energy by every density, not negative [J m^3/kg]; those `fixed` last.
        stiffness: the second derivative, not negative.
        exactness: 1 for the exact Hessian, 0 for a convex one, and shares of both in between. In the convex one a pair
            keeps `REPULSION` of its own Hessian along the line between its vertices where that is positive.
        fixed: vertices in the same grid that do not move.
    """
    split = len(particles.order)
    blocks = [(particles, slice(0, split), particles, slice(0, split))]
    if fixed is not None:
        resting = slice(split, split + len(fixed.order))
        blocks += [(particles, slice(0, split), fixed, resting), (fixed, resting, particles, slice(0, split))]
    counts = np.zeros(len(pressure), np.int64)
    for rows, where, others, there in blocks:
        pair = (rows.particles, others.particles, particles.grid.shape, particles.smoothing_length)
        _count(*pair, stiffness[where], stiffness[there], counts[where])
    first = np.concatenate([[0], np.cumsum(counts)])
    mass = particles.mass if fixed is None else np.concatenate([particles.mass, fixed.mass])
    # Zeros: what `_list` leaves out of the count is a pair of no effect.
    across, along, gradient = (np.zeros((first[-1], *axes), np.float32) for axes in ((), (), (3,)))
    pairs = PressedPairs(first, np.zeros(first[-1], np.int32), gradient, across, along, mass, stiffness)
    cursor = first[:-1].copy()
    for rows, where, others, there in blocks:
        pair = (rows.particles, others.particles, particles.grid.shape, particles.smoothing_length)
        derivatives = (pressure[where], pressure[there], stiffness[where], stiffness[there])
        _list(*pair, _Rows(*derivatives, cursor[where], there.start, exactness), pairs)
    return pairs


class _Rows(NamedTuple):
    """What `_list` needs of its rows and of the vertices near by.

    Attributes:
        own_pressure, own_stiffness, pressure, stiffness: derivatives of the energy by their densities.
        cursor: where the next pair of each row is written.
        offset: index of the first of those near by among all.
        exactness: as in `pressed_pairs`.
    """

    own_pressure: np.ndarray
    pressure: np.ndarray
    own_stiffness: np.ndarray
    stiffness: np.ndarray
    cursor: np.ndarray
    offset: int
    exactness: float


@njit(cache=True, parallel=True, fastmath=True)
def _count(
    rows: Particles, others: Particles, shape: tuple[int, int, int], h: float, own_stiffness: np.ndarray,
    stiffness: np.ndarray, counts: np.ndarray,
) -> None:  # fmt: skip
    """Add the number of pairs of every row to `counts`."""
    support = 4.0 * h * h
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, others.start, ranges)
        for row in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz, own = rows.x[row], rows.y[row], rows.z[row], own_stiffness[row]
            count = 0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, theirs = others.x[near_by], others.y[near_by], others.z[near_by], stiffness[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    count += (dx * dx + dy * dy + dz * dz < support) & (own + theirs[other] > 0.0)
            counts[row] += count


@njit(cache=True, parallel=True, fastmath=True)
def _list(
    rows: Particles, near_by: Particles, shape: tuple[int, int, int], h: float, state: _Rows, pairs: PressedPairs
) -> None:
    """Write the pairs of every row from its `cursor` on, and move that behind them."""
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] < rows.start[cell + 1]:
            _list_cell(cell, rows, near_by, shape, h, state, pairs)


# Called, not written out in the parallel loop: numba would drop assignments to fields of a tuple there as dead code.
@njit(cache=True, fastmath=True)
def _list_cell(
    cell: int, rows: Particles, near_by: Particles, shape: tuple[int, int, int], h: float, state: _Rows,
    pairs: PressedPairs,
) -> None:  # fmt: skip
    exactness, stiffness = state.exactness, state.stiffness
    support, inverse, scale = RIM * 4.0 * h * h, 1.0 / h, 1.0 / (4.0 * math.pi * h**4)
    ranges = np.empty((9, 2), np.int64)
    found = cell_columns(cell, shape, near_by.start, ranges)
    candidates = 1
    for column in range(found):
        candidates += ranges[column, 1] - ranges[column, 0]
    kept = np.empty(candidates, np.int32)
    for row in range(rows.start[cell], rows.start[cell + 1]):
        px, py, pz, own = rows.x[row], rows.y[row], rows.z[row], state.own_stiffness[row]
        count = 0
        for column in range(found):
            for other in range(ranges[column, 0], ranges[column, 1]):
                dx, dy, dz = px - near_by.x[other], py - near_by.y[other], pz - near_by.z[other]
                # No branch: most are too far away, and which cannot be foreseen.
                kept[count] = other
                count += (dx * dx + dy * dy + dz * dz < support) & (own + stiffness[other] > 0.0)
        at, mass = state.cursor[row], rows.weight[row]
        for other in kept[:count]:
            dx, dy, dz = px - near_by.x[other], py - near_by.y[other], pz - near_by.z[other]
            squared = dx * dx + dy * dy + dz * dz
            r = max(np.sqrt(squared), 1e-9)
            away = 1.0 / r
            far, near = 2.0 - r * inverse, max(1.0 - r * inverse, 0.0)
            steepness = scale * kernel_slope(r * inverse)
            bend = 3.0 * scale * inverse * (2.0 * far - 8.0 * near)
            unit = steepness * away
            pairs.other[at] = state.offset + other
            pairs.kernel_gradient[at, 0], pairs.kernel_gradient[at, 1], pairs.kernel_gradient[at, 2] = (
                unit * dx,
                unit * dy,
                unit * dz,
            )
            push = state.own_pressure[row] * near_by.weight[other] + state.pressure[other] * mass
            across = exactness * push * unit
            bend = exactness * bend + (1.0 - exactness) * REPULSION * max(bend, 0.0)
            # A vertex is its own neighbour too, at no distance.
            pairs.across[at] = across if squared > 0.0 else 0.0
            pairs.along[at] = (push * bend - across) / max(steepness * steepness, 1e-30) if squared > 0.0 else 0.0
            at += 1
        state.cursor[row] = at
