"""Compiled parts of `quaffure.model.surroundings`."""

import numpy as np
from jaxtyping import Float
from numba import get_num_threads, njit, prange

from quaffure.geometry.mls_kernels import FAST

SURROUNDING_FEATURES = 5
"""Numbers of a vertex: excess of the density over that in the design, its gradient, and the collision margin."""
CELL = 0.008
"""Side of a cell [m]."""
NODES = (64, 64, 128)
"""Nodes along each axis of the head's frame before the grid repeats itself; powers of two."""
EXCESS_UNIT, SLOPE_UNIT = 0.5, 100.0
"""Density [kg/m^3] and gradient [kg/m^4] beyond which features grow as a logarithm."""
MARGIN_UNIT = 0.01
"""Unit of the collision margin [m]."""


def write_surroundings(
    rest_length: Float[np.ndarray, "s e"],
    mass: Float[np.ndarray, "s n"],
    rest_density: Float[np.ndarray, "s n"],
    margin: Float[np.ndarray, "s n"],
    roots: Float[np.ndarray, "b r 3"],
    edges: Float[np.ndarray, "b r e 3"],
    features: np.ndarray,
) -> None:
    """`quaffure.model.surroundings.fill_surroundings`, whose first argument are the first four."""
    positions, grid = np.empty((*mass.shape, 3), np.float32), np.empty(NODES, np.float32)
    for own_roots, own_edges, own_features in zip(roots, edges, features):
        grid.fill(0.0)
        _spread(own_roots, own_edges, rest_length, mass, positions, grid)
        _read(positions, rest_density, margin, grid, get_num_threads(), own_features)


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _place(value: float) -> tuple[int, float]:
    """Node before a coordinate, and the share of the way to the next one."""
    scaled = value * np.float32(1 / CELL)
    first = np.floor(scaled)
    return int(first), scaled - first


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _spread(
    roots: np.ndarray, edges: np.ndarray, rest_length: np.ndarray, mass: np.ndarray, positions: np.ndarray,
    grid: np.ndarray,
) -> None:  # fmt: skip
    """Fill the strands' vertices and add their masses to the grid."""
    count, vertices = mass.shape
    per_volume = np.float32(1 / CELL**3)
    a, b, c = np.int64(NODES[0] - 1), np.int64(NODES[1] - 1), np.int64(NODES[2] - 1)
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
            i, u = _place(x)
            j, v = _place(y)
            k, w = _place(z)
            i0, i1, j0, j1, k0, k1 = i & a, (i + 1) & a, j & b, (j + 1) & b, k & c, (k + 1) & c
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
    positions: np.ndarray, rest_density: np.ndarray, margin: np.ndarray, grid: np.ndarray, threads: int,
    features: np.ndarray,
) -> None:  # fmt: skip
    """Write the features of all vertices but the first."""
    a, b, c = np.int64(NODES[0] - 1), np.int64(NODES[1] - 1), np.int64(NODES[2] - 1)
    one = np.float32(1)
    spaces = np.empty((threads, SURROUNDING_FEATURES), np.float32)
    shift = np.uint32(32 - 8 * features.itemsize)
    half = np.uint32(0x7FFF) if features.itemsize == 2 else np.uint32(0)
    for thread in prange(threads):
        values = spaces[thread]
        words = values.view(np.uint32)
        for row in range(thread, len(positions), threads):
            for vertex in range(1, positions.shape[1]):
                i, u = _place(positions[row, vertex, 0])
                j, v = _place(positions[row, vertex, 1])
                k, w = _place(positions[row, vertex, 2])
                i0, i1, j0, j1, k0, k1 = i & a, (i + 1) & a, j & b, (j + 1) & b, k & c, (k + 1) & c
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
                values[0] = np.arcsinh((density - rest_density[row, vertex]) * np.float32(1 / EXCESS_UNIT))
                per = np.float32(1 / (CELL * SLOPE_UNIT))
                size = per * np.sqrt(dx * dx + dy * dy + dz * dz)
                scale = per * np.arcsinh(size) / max(size, np.float32(1e-6))
                values[1], values[2], values[3] = scale * dx, scale * dy, scale * dz
                values[4] = np.float32(1 / MARGIN_UNIT) * margin[row, vertex]
                at = SURROUNDING_FEATURES * (vertex - 1)
                for n in range(SURROUNDING_FEATURES):
                    odd = (words[n] >> shift) & np.uint32(1)
                    rounded = words[n] if features.itemsize == 4 else words[n] + half + odd
                    features[row, at + n] = rounded >> shift
