"""Eqs. 11-13 in double precision: vertices sorted into cells, their densities, the gradient of what depends on those.

Value and gradient are those of `quaffure.energies.fused_density`, the twin in single precision. Arrays in sorted
order follow the cells of a grid, so that neighbours lie together in memory.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numba import njit, prange

from quaffure.energies.fused_density import Particles
from quaffure.energies.smoothing_kernel import kernel_slope, kernel_value
from quaffure.geometry.cell_list import Grid, cell_columns, check_finite, grid_round, sort_into_grid


class DensityParticles(NamedTuple):
    """Vertices in the order of the cells of a grid as wide as the kernel's support.

    Attributes:
        x, y, z: positions [m].
        mass: [kg].
        order: index in the groom of every vertex.
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

    def of(self, kept: Bool[np.ndarray, " p"]) -> "DensityParticles":
        """Some of the vertices, picked in the sorted order."""
        start = np.concatenate([[0], np.cumsum(kept)])[self.start]
        x, y, z, mass, order = (field[kept] for field in self[:5])
        return DensityParticles(x, y, z, mass, order, start, self.grid, self.smoothing_length)


def density_particles(
    points: Float[np.ndarray, "p 3"], mass: Float[np.ndarray, " p"], smoothing_length: float, grid: Grid | None = None
) -> DensityParticles:
    """Vertices [m] of masses [kg], sorted into cells: those of `grid`, or of one round them.

    Raises:
        ValueError: a coordinate is not finite; no grid fits round it.
    """
    check_finite(torch.from_numpy(points))
    grid = grid or grid_round(points, np.float32(2 * smoothing_length))
    order, start = sort_into_grid(points, grid)
    x, y, z = np.ascontiguousarray(points[order].T)
    return DensityParticles(x, y, z, mass[order], order, start, grid, smoothing_length)


def density(particles: DensityParticles, others: DensityParticles | None = None) -> Float[np.ndarray, " p"]:
    """Eq. 12 of every vertex in the sorted order [kg/m^3]; `others`, in the same grid: what they alone bring."""
    found = np.empty(len(particles.order))
    near_by = (others or particles).particles
    _densities(particles.particles, near_by, particles.grid.shape, particles.smoothing_length, found)
    return found


def density_gradient(particles: DensityParticles, pressure: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """Gradient [N] of an energy whose derivative by every density is `pressure` [J m^3/kg], without a list of pairs."""
    gradient = np.empty((len(pressure), 3))
    _gradient(particles.particles, particles.grid.shape, particles.smoothing_length, pressure, gradient)
    return gradient


@njit(cache=True, parallel=True, fastmath=True)
def _densities(rows: Particles, others: Particles, shape: tuple[int, int, int], h: float, density: np.ndarray) -> None:
    scale, inverse = 1.0 / (4.0 * math.pi * h**3), 1.0 / h
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, others.start, ranges)
        for row in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz = rows.x[row], rows.y[row], rows.z[row]
            total = 0.0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses = others.x[near_by], others.y[near_by], others.z[near_by], others.weight[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    q = np.sqrt(dx * dx + dy * dy + dz * dz) * inverse
                    total += masses[other] * kernel_value(q)
            density[row] = total * scale


@njit(cache=True, parallel=True, fastmath=True)
def _gradient(
    rows: Particles, shape: tuple[int, int, int], h: float, pressure: np.ndarray, gradient: np.ndarray
) -> None:
    scale, inverse = 1.0 / (4.0 * math.pi * h**4), 1.0 / h
    for cell in prange(len(rows.start) - 1):
        if rows.start[cell] == rows.start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, rows.start, ranges)
        for row in range(rows.start[cell], rows.start[cell + 1]):
            px, py, pz = rows.x[row], rows.y[row], rows.z[row]
            own_pressure, own_mass = scale * pressure[row], scale * rows.weight[row]
            gx, gy, gz = 0.0, 0.0, 0.0
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses, pressures = (
                    rows.x[near_by], rows.y[near_by], rows.z[near_by], rows.weight[near_by], pressure[near_by]
                )  # fmt: skip
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    push = own_pressure * masses[other] + own_mass * pressures[other]
                    push *= kernel_slope(r * inverse) / max(r, 1e-9)
                    gx += push * dx
                    gy += push * dy
                    gz += push * dz
            gradient[row, 0], gradient[row, 1], gradient[row, 2] = gx, gy, gz
