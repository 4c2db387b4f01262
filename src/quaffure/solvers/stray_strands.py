"""Strands that came to rest apart from all others, such as one that was caught on a shoulder.

A strand by itself has many minima of nearly the same energy. Among them, hair takes those of the hair around it, to
which friction and entanglement hold it; neither is in the energy.
"""

import numpy as np
from numba import njit, prange
from scipy.spatial import cKDTree

from quaffure.geometry.cell_list import cell_columns, sort_into_cells

APART, BESIDE = 0.015, 0.010
"""A strand is a stray if one of its vertices is farther than `APART` [m] from all other strands, and each was within
`BESIDE` [m] of one in the posed groom."""
FIRST_VERTEX = 3
"""The first vertex of a strand that counts; those before it stand where the strand is rooted."""


def stands_apart(positions: np.ndarray, distance: float) -> np.ndarray:
    """Which strands [strand] have a vertex that is farther than `distance` [m] from every vertex of other strands.

    Args:
        positions: finite, float32 [m], [strand vertex 3].
    """
    strands, vertices = positions.shape[:2]
    points = np.ascontiguousarray(positions).reshape(-1, 3)
    order, start, shape = sort_into_cells(points, np.float32(distance))
    apart = np.zeros(len(points), np.bool_)
    _mark_apart(points[order], order, vertices, start, shape, np.float32(distance), apart)
    return np.any(apart.reshape(strands, vertices), axis=1)


def nearest_of(root: np.ndarray, strays: np.ndarray, others: np.ndarray) -> np.ndarray:
    """For each of the `strays`, which of the strands `others` is rooted nearest to it.

    Args:
        root: positions of all roots [m], [strand 3].
        strays, others: indices of strands.
    """
    return others[cKDTree(root[others]).query(root[strays])[1]]


@njit(cache=True, parallel=True)
def _mark_apart(
    points: np.ndarray, order: np.ndarray, vertices: int, start: np.ndarray, shape: tuple[int, int, int],
    distance: np.float32, apart: np.ndarray,
) -> None:  # fmt: skip
    """Mark, in the unsorted order, the points that have none of another strand within `distance`; the first vertices
    of a strand are left out. Points are sorted into cells of at least that side."""
    squared = distance * distance
    for cell in prange(len(start) - 1):
        ranges = np.empty((9, 2), np.int64)
        columns = cell_columns(cell, shape, start, ranges) if start[cell] < start[cell + 1] else 0
        for row in range(start[cell], start[cell + 1]):
            if order[row] % vertices >= FIRST_VERTEX:
                apart[order[row]] = not _has_company(row, points, order, vertices, ranges[:columns], squared)


@njit(cache=True)
def _has_company(
    row: int, points: np.ndarray, order: np.ndarray, vertices: int, ranges: np.ndarray, squared: np.float32
) -> bool:
    """Whether one of the points in these ranges is of another strand and within a squared distance of that at `row`."""
    strand = order[row] // vertices
    x, y, z = points[row, 0], points[row, 1], points[row, 2]
    for column in range(len(ranges)):
        for other in range(ranges[column, 0], ranges[column, 1]):
            dx, dy, dz = points[other, 0] - x, points[other, 1] - y, points[other, 2] - z
            if dx * dx + dy * dy + dz * dz <= squared and order[other] // vertices != strand:
                return True
    return False
