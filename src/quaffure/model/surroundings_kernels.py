"""Compiled parts of `quaffure.model.surroundings`."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.geometry.mls_kernels import FAST
from quaffure.model.bfloat16 import stored

SURROUNDING_FEATURES = 5
"""Numbers of a vertex: excess of the density over that in the design, its gradient, and the collision margin."""
NODES = (64, 64, 128)
"""Nodes along each axis of the head's frame before the grid repeats itself; powers of two."""


class GridUnits(NamedTuple):
    """Inverse units: of a position, the density's excess, its change along a cell, and the margin."""

    cell: np.float32
    excess: np.float32
    slope: np.float32
    margin: np.float32


@njit(cache=True)
def write_surroundings(
    strands: tuple[np.ndarray, ...], roots: np.ndarray, edges: np.ndarray, units: GridUnits, threads: int,
    features: np.ndarray,
) -> None:  # fmt: skip
    """Write the features of all vertices but the root (`quaffure.model.surroundings.surroundings_reference`); float32.

    Args:
        strands: `quaffure.model.surroundings.Surroundings` of the rows, as arrays.
        roots, edges: of each row in the head's frame, [batch, row, 3] [m] and unit edges [batch, row, edge, 3]; there
            may be more rows than strands, which are left out.
        features: [batch, row, column] to write, bits of float32 or bfloat16 (`quaffure.model.initial_shape.bits`).
    """
    rest_length, mass, rest_density, margin = strands
    positions, grid = np.empty((*mass.shape, 3), np.float32), np.empty(NODES, np.float32)
    for sample in range(len(roots)):
        grid[:] = np.float32(0.0)
        _spread(roots[sample], edges[sample], rest_length, mass, units.cell, positions, grid)
        _read(positions, rest_density, margin, grid, units, threads, features[sample])


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _node_and_share(value: np.float32, per_cell: np.float32) -> tuple[int, np.float32]:
    """Node before a coordinate, and the share of the way to the next one."""
    scaled = value * per_cell
    first = np.floor(scaled)
    return int(first), scaled - first


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _spread(
    roots: np.ndarray, edges: np.ndarray, rest_length: np.ndarray, mass: np.ndarray, per_cell: np.float32,
    positions: np.ndarray, grid: np.ndarray,
) -> None:  # fmt: skip
    """Fill the strands' vertices and add their masses to the grid."""
    count, vertices = mass.shape
    per_volume = per_cell * per_cell * per_cell
    mask_x, mask_y, mask_z = np.int64(NODES[0] - 1), np.int64(NODES[1] - 1), np.int64(NODES[2] - 1)
    for row in range(count):
        x, y, z = roots[row, 0], roots[row, 1], roots[row, 2]
        for vertex in range(vertices):
            if vertex > 0:
                length = rest_length[row, vertex - 1]
                x += length * edges[row, vertex - 1, 0]
                y += length * edges[row, vertex - 1, 1]
                z += length * edges[row, vertex - 1, 2]
            positions[row, vertex, 0], positions[row, vertex, 1], positions[row, vertex, 2] = x, y, z
            own = per_volume * mass[row, vertex]
            i, u = _node_and_share(x, per_cell)
            j, v = _node_and_share(y, per_cell)
            k, w = _node_and_share(z, per_cell)
            i0, i1, j0, j1 = i & mask_x, (i + 1) & mask_x, j & mask_y, (j + 1) & mask_y
            k0, k1 = k & mask_z, (k + 1) & mask_z
            near, far = own * (np.float32(1) - u), own * u
            left = np.float32(1) - v
            low = np.float32(1) - w
            grid[i0, j0, k0] += near * left * low
            grid[i0, j0, k1] += near * left * w
            grid[i0, j1, k0] += near * v * low
            grid[i0, j1, k1] += near * v * w
            grid[i1, j0, k0] += far * left * low
            grid[i1, j0, k1] += far * left * w
            grid[i1, j1, k0] += far * v * low
            grid[i1, j1, k1] += far * v * w


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _read(
    positions: np.ndarray, rest_density: np.ndarray, margin: np.ndarray, grid: np.ndarray,
    per: GridUnits, threads: int, features: np.ndarray,
) -> None:  # fmt: skip
    """Write the features of all vertices but the first."""
    mask_x, mask_y, mask_z = np.int64(NODES[0] - 1), np.int64(NODES[1] - 1), np.int64(NODES[2] - 1)
    one = np.float32(1)
    workspace = np.empty((threads, SURROUNDING_FEATURES), np.float32)
    for thread in prange(threads):
        values = workspace[thread]
        words = values.view(np.uint32)
        for row in range(thread, len(positions), threads):
            for vertex in range(1, positions.shape[1]):
                i, u = _node_and_share(positions[row, vertex, 0], per.cell)
                j, v = _node_and_share(positions[row, vertex, 1], per.cell)
                k, w = _node_and_share(positions[row, vertex, 2], per.cell)
                i0, i1, j0, j1 = i & mask_x, (i + 1) & mask_x, j & mask_y, (j + 1) & mask_y
                k0, k1 = k & mask_z, (k + 1) & mask_z
                g000, g001, g010, g011 = grid[i0, j0, k0], grid[i0, j0, k1], grid[i0, j1, k0], grid[i0, j1, k1]
                g100, g101, g110, g111 = grid[i1, j0, k0], grid[i1, j0, k1], grid[i1, j1, k0], grid[i1, j1, k1]
                # Along z, then y, then x.
                n00, n01 = g000 + w * (g001 - g000), g010 + w * (g011 - g010)
                n10, n11 = g100 + w * (g101 - g100), g110 + w * (g111 - g110)
                m0, m1 = n00 + v * (n01 - n00), n10 + v * (n11 - n10)
                density = m0 + u * (m1 - m0)
                dx = m1 - m0
                dy = (one - u) * (n01 - n00) + u * (n11 - n10)
                dz = (one - u) * ((one - v) * (g001 - g000) + v * (g011 - g010)) + u * (
                    (one - v) * (g101 - g100) + v * (g111 - g110)
                )
                values[0] = np.arcsinh((density - rest_density[row, vertex]) * per.excess)
                size = per.slope * np.sqrt(dx * dx + dy * dy + dz * dz)
                scale = per.slope * np.arcsinh(size) / max(size, np.float32(1e-6))
                values[1], values[2], values[3] = scale * dx, scale * dy, scale * dz
                values[4] = per.margin * margin[row, vertex]
                at = SURROUNDING_FEATURES * (vertex - 1)
                for n in range(SURROUNDING_FEATURES):
                    features[row, at + n] = stored(words[n], features.itemsize)
