"""Pairs of points closer than a radius: integers from a compiled cell list, or from its torch twin."""

import numpy as np
import torch
from numba import njit, prange

from quaffure.types import Float, Int, Tensor

_REFERENCE_PAIRS = 16_000_000  # point pairs that the twin holds in memory at once


def fixed_radius_pairs(points: Float[Tensor, "p 3"], radius: float) -> Int[Tensor, "2 m"]:
    """Every unordered pair of distinct points at most `radius` [m] apart, once, the smaller index first.

    Compiled on the CPU, where points are compared in float32; the twin elsewhere. The order of pairs is unspecified.

    Raises:
        ValueError: a coordinate is not finite.
    """
    check_finite(points)
    if points.device.type != "cpu":
        return fixed_radius_pairs_reference(points, radius)
    array = np.ascontiguousarray(points.detach().numpy(), dtype=np.float32)
    order, cell_start, shape = sort_into_cells(array, np.float32(radius))
    cells = (array[order], order, cell_start, shape, np.float32(radius))
    counts = np.zeros(len(array), np.int64)
    _list_pairs(*cells, counts, np.empty((2, 0), np.int64))
    pairs = np.empty((2, counts.sum()), np.int64)
    _list_pairs(*cells, np.cumsum(counts) - counts, pairs)
    return torch.from_numpy(pairs)


def check_finite(positions: Tensor) -> None:
    """Compiled searches turn coordinates into indices, so none may be NaN or infinite.

    Raises:
        ValueError: one is.
    """
    if not bool(torch.isfinite(positions).all()):
        raise ValueError("expected finite positions, found NaN or infinity")


def fixed_radius_pairs_reference(points: Float[Tensor, "p 3"], radius: float) -> Int[Tensor, "2 m"]:
    """Torch twin of `fixed_radius_pairs`: every point against every other, in chunks."""
    points = points.detach()
    chunk = max(1, _REFERENCE_PAIRS // max(1, len(points)))
    found = []
    for start in range(0, len(points), chunk):
        squared = (points[start : start + chunk, None] - points[None]).square().sum(-1)
        first, second = torch.nonzero(squared <= radius**2, as_tuple=True)
        found.append(torch.stack([first + start, second]))
    pairs = torch.cat(found, dim=1)
    return pairs[:, pairs[0] < pairs[1]]


@njit(cache=True)
def sort_into_cells(points: np.ndarray, size: np.float32) -> tuple[np.ndarray, np.ndarray, tuple[int, int, int]]:
    """Counting sort of points into a grid of cells of side `size`, or larger where that would need too many.

    Returns the sorted order, where each cell starts in it (one more entry than cells), and the cells along x, y, z.
    """
    lower = np.array([points[:, axis].min() for axis in range(3)])
    upper = np.array([points[:, axis].max() for axis in range(3)])
    side = size
    while True:
        # One stray point far away must not make a grid that fills the memory. In floats: integers would wrap.
        along = (upper - lower).astype(np.float64) / side + 1.0
        if along[0] * along[1] * along[2] <= 64 * len(points) + 4096:
            break
        side *= np.float32(1.5)
    nx, ny, nz = int(along[0]), int(along[1]), int(along[2])
    cells = np.empty(len(points), np.int64)
    start = np.zeros(nx * ny * nz + 1, np.int64)
    for index in range(len(points)):
        # A quotient may round up to the number of cells.
        ix = min(int((points[index, 0] - lower[0]) / side), nx - 1)
        iy = min(int((points[index, 1] - lower[1]) / side), ny - 1)
        iz = min(int((points[index, 2] - lower[2]) / side), nz - 1)
        cells[index] = (ix * ny + iy) * nz + iz
        start[cells[index] + 1] += 1
    start = np.cumsum(start)
    cursor = start.copy()
    order = np.empty(len(points), np.int64)
    for index in range(len(points)):
        order[cursor[cells[index]]] = index
        cursor[cells[index]] += 1
    return order, start, (nx, ny, nz)


@njit(cache=True, inline="always")
def interleaved(index: int, count: int, threads: int) -> int:
    """The item at `index` of a parallel loop over `count` + `threads` in an interleaved schedule of the items.

    Each thread takes one run of indices; dense cells lie together in space, and one thread would get all of them.
    Indices without an item give `count` or more.
    """
    rounds = (count + threads - 1) // threads
    return (index % rounds) * threads + index // rounds if index < rounds * threads else count


@njit(cache=True, inline="always")
def cell_columns(cell: int, shape: tuple[int, int, int], start: np.ndarray, ranges: np.ndarray) -> int:
    """Write the ranges of sorted points of the 3 x 3 columns of cells round `cell`; return how many there are.

    Cells are numbered along z fastest, so three neighbouring cells of a column are one range.
    """
    _, ny, nz = shape
    iz = cell % nz
    iy = (cell // nz) % ny
    ix = cell // (nz * ny)
    found = 0
    for jx in range(max(0, ix - 1), min(shape[0], ix + 2)):
        for jy in range(max(0, iy - 1), min(ny, iy + 2)):
            base = (jx * ny + jy) * nz
            ranges[found, 0] = start[base + max(0, iz - 1)]
            ranges[found, 1] = start[base + min(nz - 1, iz + 1) + 1]
            found += 1
    return found


@njit(cache=True, parallel=True)
def _list_pairs(
    points: np.ndarray, order: np.ndarray, start: np.ndarray, shape: tuple[int, int, int], radius: np.float32,
    cursor: np.ndarray, pairs: np.ndarray,
) -> None:  # fmt: skip
    """Write the pairs of every sorted point to `pairs` from its `cursor` on, and move that behind them.

    What does not fit is counted alone.
    """
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for row in range(start[cell], start[cell + 1]):
            at = cursor[row]
            for column in range(found):
                for other in range(max(row + 1, ranges[column, 0]), ranges[column, 1]):
                    dx, dy = points[row, 0] - points[other, 0], points[row, 1] - points[other, 1]
                    dz = points[row, 2] - points[other, 2]
                    if dx * dx + dy * dy + dz * dz <= radius * radius:
                        if at < pairs.shape[1]:
                            pairs[0, at] = min(order[row], order[other])
                            pairs[1, at] = max(order[row], order[other])
                        at += 1
            cursor[row] = at
