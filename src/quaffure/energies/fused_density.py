"""Eqs. 11-13 in two compiled passes over a cell list, value and gradient, without a list of pairs.

Its torch twin is `quaffure.energies.self_collision`; a test holds the two together.
"""

import math

import numpy as np
import torch
from numba import njit, prange
from torch.autograd.function import FunctionCtx

from quaffure.config import HairMaterial
from quaffure.energies.rest_state import RestState
from quaffure.geometry.neighbors import cell_columns, check_finite, sort_into_cells
from quaffure.types import Energy, Positions, Tensor


def fused_self_collision(positions: Positions, rest: RestState, material: HairMaterial) -> Energy:
    """Eq. 11 [J], differentiable in the positions [m], float32, on the CPU.

    Raises:
        ValueError: a coordinate is not finite.
    """
    check_finite(positions)
    return _SelfCollision.apply(positions, rest, material)


class _SelfCollision(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, positions: Tensor, rest: RestState, material: HairMaterial) -> Tensor:
        batch = len(positions)
        flat = positions.detach().contiguous().reshape(batch, -1, 3).numpy()
        gradient = np.zeros_like(flat)
        energy = torch.zeros(batch)
        mass, rest_density = rest.mass.flatten().numpy(), rest.rest_density.flatten().numpy()
        h = np.float32(material.smoothing_length)
        for sample in range(batch):
            order, start, shape = sort_into_cells(flat[sample], np.float32(2) * h)
            # One array a coordinate: the compiler then runs 8 or 16 neighbours abreast.
            x, y, z = np.ascontiguousarray(flat[sample][order].T)
            masses = mass[order]
            excess = np.empty(len(order), np.float32)
            _excess(x, y, z, masses, rest_density[order], start, shape, h, excess)
            energy[sample] = material.k_self_collision * float((excess.astype(np.float64) ** 3).sum())
            slope = np.float32(3 * material.k_self_collision) * excess * excess
            _gradient(x, y, z, masses, slope, order, start, shape, h, gradient[sample])
        ctx.save_for_backward(torch.from_numpy(gradient).reshape(positions.shape))
        return energy

    @staticmethod
    def backward(ctx: FunctionCtx, *upstream: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors  # type: ignore[attr-defined]
        return gradient * upstream[0][:, None, None, None], None, None


@njit(cache=True, parallel=True, fastmath=True)
def _excess(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, mass: np.ndarray, rest_density: np.ndarray,
    start: np.ndarray, shape: tuple[int, int, int], h: np.float32, excess: np.ndarray,
) -> None:  # fmt: skip
    scale = np.float32(1.0 / (4.0 * math.pi)) / (h * h * h)
    inverse = np.float32(1.0) / h
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for place in range(start[cell], start[cell + 1]):
            px, py, pz = x[place], y[place], z[place]
            total = np.float32(0.0)
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses = x[near_by], y[near_by], z[near_by], mass[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    q = np.sqrt(dx * dx + dy * dy + dz * dz) * inverse
                    # (2 - q)+^3 - 4 (1 - q)+^3 is Eq. 13 without a branch.
                    far, near = max(np.float32(2.0) - q, np.float32(0.0)), max(np.float32(1.0) - q, np.float32(0.0))
                    total += masses[other] * (far * far * far - np.float32(4.0) * near * near * near)
            excess[place] = max(total * scale - rest_density[place], np.float32(0.0))


@njit(cache=True, parallel=True, fastmath=True)
def _gradient(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, mass: np.ndarray, slope: np.ndarray, order: np.ndarray,
    start: np.ndarray, shape: tuple[int, int, int], h: np.float32, gradient: np.ndarray,
) -> None:  # fmt: skip
    scale = np.float32(3.0 / (4.0 * math.pi)) / (h * h * h * h)
    inverse = np.float32(1.0) / h
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for place in range(start[cell], start[cell + 1]):
            px, py, pz = x[place], y[place], z[place]
            own_mass, own_slope = mass[place], slope[place]
            gx, gy, gz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses, slopes = x[near_by], y[near_by], z[near_by], mass[near_by], slope[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    q = r * inverse
                    far, near = max(np.float32(2.0) - q, np.float32(0.0)), max(np.float32(1.0) - q, np.float32(0.0))
                    slope_of_kernel = np.float32(4.0) * near * near - far * far
                    pull = (own_slope * masses[other] + slopes[other] * own_mass) * slope_of_kernel
                    pull /= max(r, np.float32(1e-8))
                    gx += pull * dx
                    gy += pull * dy
                    gz += pull * dz
            at = order[place]
            gradient[at, 0] = scale * gx
            gradient[at, 1] = scale * gy
            gradient[at, 2] = scale * gz
