"""Eqs. 11-13 in two compiled passes over a cell list, value and gradient, without a list of pairs.

The second pass visits active vertices alone: most hair is no denser than at rest, and a pair without excess on either
side exerts no force. Its torch twin is `quaffure.energies.self_collision`; a test holds the two together.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.config import HairMaterial
from quaffure.energies.known_gradient import with_gradient
from quaffure.energies.rest_state import RestState
from quaffure.energies.smoothing_kernel import kernel_slope, kernel_value, per_kernel_volume
from quaffure.geometry.cell_list import cell_columns, check_finite, interleaved, sort_into_cells
from quaffure.types import Energy, Float, Positions, Tensor


def fused_self_collision(positions: Positions, rest: RestState, material: HairMaterial) -> Energy:
    """Eq. 11 [J], differentiable in the positions [m], float32, on the CPU.

    Raises:
        ValueError: a coordinate is not finite.
    """
    check_finite(positions)
    if material.k_self_collision == 0:  # nothing to search neighbours for
        return with_gradient(positions, positions.new_zeros(len(positions)), torch.zeros_like(positions))
    found = [self_collision_and_gradient(sample.detach(), rest, material) for sample in positions]
    energy = positions.new_tensor([own for own, _ in found])
    return with_gradient(positions, energy, torch.stack([gradient for _, gradient in found]))


class Particles(NamedTuple):
    """Vertices sorted into cells, one array a coordinate, so that the compiler vectorizes over 8 or 16 neighbours.

    Attributes:
        weight: what each counts in a sum over neighbours.
        start: where each cell starts, one more than there are cells.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    weight: np.ndarray
    start: np.ndarray


def self_collision_and_gradient(
    positions: Float[Tensor, "s n 3"], rest: RestState, material: HairMaterial
) -> tuple[float, Float[Tensor, "s n 3"]]:
    """Eq. 11 of one sample [J] and its gradient by the vertices [N]; positions are float32 and finite [m]."""
    flat = positions.contiguous().reshape(-1, 3).numpy()
    gradient = np.empty_like(flat)
    mass, rest_density = rest.mass.flatten().numpy(), rest.rest_density.flatten().numpy()
    h = np.float32(material.smoothing_length)
    order, shape, particles = sort_particles(flat, mass, np.float32(2) * h)
    excess = np.empty(len(order), np.float32)
    _excess(particles, shape, rest_density, order, h, get_num_threads(), excess)
    slope = np.float32(3 * material.k_self_collision) * excess * excess
    active = active_particles(particles, slope)
    density_gradient(particles, active, shape, slope, order, h, get_num_threads(), gradient)
    energy = material.k_self_collision * float((excess.astype(np.float64) ** 3).sum())
    return energy, torch.from_numpy(gradient).reshape(positions.shape)


@njit(cache=True)
def sort_particles(
    points: np.ndarray, mass: np.ndarray, size: np.float32
) -> tuple[np.ndarray, tuple[int, int, int], Particles]:
    """The order of the vertices in cells of side `size`, the cells along x, y, z, and the vertices in that order,
    weighted by their masses."""
    order, start, shape = sort_into_cells(points, size)
    x, y, z = points[order, 0], points[order, 1], points[order, 2]
    return order, shape, Particles(x, y, z, mass[order], start)


@njit(cache=True)
def active_particles(particles: Particles, slope: np.ndarray) -> Particles:
    """The vertices whose `slope` is above 0 alone, weighted by it."""
    kept = slope > 0
    before = np.zeros(len(kept) + 1, np.int64)
    before[1:] = np.cumsum(kept)
    x, y, z = particles.x[kept], particles.y[kept], particles.z[kept]
    return Particles(x, y, z, slope[kept], before[particles.start])


@njit(cache=True, parallel=True, fastmath=True)
def _excess(
    particles: Particles, shape: tuple[int, int, int], rest_density: np.ndarray, order: np.ndarray, h: np.float32,
    threads: int, excess: np.ndarray,
) -> None:  # fmt: skip
    """Density minus that at rest [kg/m^3] where it is above, in the sorted order; `rest_density` is not."""
    scale = per_kernel_volume(h)
    inverse = np.float32(1.0) / h
    start = particles.start
    columns, along = shape[0] * shape[1], shape[2]
    for index in prange(columns + threads):
        column = interleaved(index, columns, threads)
        if column >= columns or start[column * along] == start[(column + 1) * along]:
            continue
        workspace, ranges = np.empty((4, 256), np.float32), np.empty((9, 2), np.int64)
        for cell in range(column * along, (column + 1) * along):
            if start[cell] == start[cell + 1]:
                continue
            workspace, count = _near_by(cell, particles, shape, ranges, workspace)
            xs, ys, zs, masses = workspace[0, :count], workspace[1, :count], workspace[2, :count], workspace[3, :count]
            for row in range(start[cell], start[cell + 1]):
                px, py, pz = particles.x[row], particles.y[row], particles.z[row]
                total = np.float32(0.0)
                for other in range(count):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    q = np.sqrt(dx * dx + dy * dy + dz * dz) * inverse
                    total += masses[other] * kernel_value(q)
                excess[row] = max(total * scale - rest_density[order[row]], np.float32(0.0))


@njit(cache=True, parallel=True, fastmath=True)
def density_gradient(
    particles: Particles, active: Particles, shape: tuple[int, int, int], slope: np.ndarray, order: np.ndarray,
    h: np.float32, threads: int, gradient: np.ndarray,
) -> None:  # fmt: skip
    """Gradient of an energy whose derivative by every density is `slope`: a vertex is pushed by the active ones near
    it, and by all near it if it is active itself.

    Args:
        active: `active_particles` of the same.
        slope: in the sorted order, not negative [J m^3/kg].
        threads: that share the work.
        gradient: filled, in the unsorted order [N].
    """
    scale = per_kernel_volume(h) / h
    inverse = np.float32(1.0) / h
    start = particles.start
    columns, along = shape[0] * shape[1], shape[2]
    for index in prange(columns + threads):
        column = interleaved(index, columns, threads)
        if column >= columns or start[column * along] == start[(column + 1) * along]:
            continue
        near_active, near_all = np.empty((4, 256), np.float32), np.empty((4, 256), np.float32)
        ranges, all_count = np.empty((9, 2), np.int64), 0
        for cell in range(column * along, (column + 1) * along):
            if start[cell] == start[cell + 1]:
                continue
            near_active, active_count = _near_by(cell, active, shape, ranges, near_active)
            if active.start[cell] < active.start[cell + 1]:
                near_all, all_count = _near_by(cell, particles, shape, ranges, near_all)
            for row in range(start[cell], start[cell + 1]):
                px, py, pz, at = particles.x[row], particles.y[row], particles.z[row], order[row]
                gx, gy, gz = _slopes(px, py, pz, near_active, active_count, inverse, scale * particles.weight[row])
                if slope[row] > 0.0:
                    ox, oy, oz = _slopes(px, py, pz, near_all, all_count, inverse, scale * slope[row])
                    gx, gy, gz = gx + ox, gy + oy, gz + oz
                gradient[at, 0], gradient[at, 1], gradient[at, 2] = gx, gy, gz


@njit(cache=True)
def _near_by(
    cell: int, particles: Particles, shape: tuple[int, int, int], ranges: np.ndarray, workspace: np.ndarray
) -> tuple[np.ndarray, int]:
    """Write x, y, z and weight of all vertices in a cell and those round it to `workspace` [4, vertex]: one run for the
    compiler. Returns it, or a larger one, and the number of vertices."""
    found = cell_columns(cell, shape, particles.start, ranges)
    count = 0
    for column in range(found):
        count += ranges[column, 1] - ranges[column, 0]
    if count > workspace.shape[1]:
        workspace = np.empty((4, 2 * count), np.float32)
    at = 0
    for column in range(found):
        for row in range(ranges[column, 0], ranges[column, 1]):
            workspace[0, at], workspace[1, at] = particles.x[row], particles.y[row]
            workspace[2, at], workspace[3, at] = particles.z[row], particles.weight[row]
            at += 1
    return workspace, count


@njit(cache=True, fastmath=True, inline="always")
def _slopes(
    px: np.float32, py: np.float32, pz: np.float32, others: np.ndarray, count: int, inverse: np.float32,
    scale: np.float32,
) -> tuple[np.float32, np.float32, np.float32]:  # fmt: skip
    """Weighted sum over the first `count` of `others` [4, vertex] of the gradient of Eq. 13 at p, times h `scale`."""
    gx, gy, gz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    xs, ys, zs, weights = others[0, :count], others[1, :count], others[2, :count], others[3, :count]
    for other in range(count):
        dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
        r = np.sqrt(dx * dx + dy * dy + dz * dz)
        slope = weights[other] * kernel_slope(r * inverse) / max(r, np.float32(1e-8))
        gx += slope * dx
        gy += slope * dy
        gz += slope * dz
    return scale * gx, scale * gy, scale * gz
