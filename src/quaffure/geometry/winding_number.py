"""How often a closed surface winds round a point: an inside test that shares nothing with the nearest-face searches.

For a closed surface the generalized winding number (Jacobson et al. 2013) is a whole number, and counts the faces that
any ray from the point meets: +1 where it leaves through a face, -1 where it enters. Here the ray goes straight up.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit, prange

CELL = 0.005
"""Width of the columns that faces are sorted into [m]."""
MOST_CELLS = 512
"""Columns along an axis, at most."""


def is_inside(
    points: Float[np.ndarray, "*p 3"], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "k 3"]
) -> Bool[np.ndarray, "*p"]:
    """Which points [m] are inside a closed surface: where its winding number is positive. Arguments as below."""
    return (winding_numbers(points.reshape(-1, 3), vertices, faces) > 0).reshape(points.shape[:-1])


def winding_numbers(
    points: Float[np.ndarray, "p 3"], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "k 3"]
) -> Int[np.ndarray, " p"]:
    """Winding number of a closed surface about points [m]: 0 outside, 1 inside, 2 where the surface overlaps itself.

    Exact but for points that a face passes within rounding of. A point straight above or below an edge counts for one
    of the two faces, and always the same one.

    Args:
        faces: counter-clockwise seen from outside.
    """
    # One layout, or the kernels would be compiled for each.
    points, vertices = (np.ascontiguousarray(array, dtype=np.float64) for array in (points, vertices))
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    width = max(CELL, float((high - low).max()) / MOST_CELLS)
    shape = np.maximum(np.ceil((high - low) / width), 1).astype(np.int64)
    start, members = _columns(vertices, faces, low, width, shape)
    return _count(points, vertices, faces, low, width, shape, start, members)


@njit(cache=True)
def _columns(
    vertices: np.ndarray, faces: np.ndarray, low: np.ndarray, width: float, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The faces over every column, packed: those of column i are members[start[i] : start[i + 1]]."""
    start = np.zeros(shape[0] * shape[1] + 1, np.int64)
    members = np.empty(0, np.int64)
    cell = np.empty((len(faces), 4), np.int64)
    for face in range(len(faces)):
        for axis in range(2):
            a, b, c = vertices[faces[face, 0], axis], vertices[faces[face, 1], axis], vertices[faces[face, 2], axis]
            cell[face, axis] = min(int((min(a, b, c) - low[axis]) / width), shape[axis] - 1)
            cell[face, 2 + axis] = min(int((max(a, b, c) - low[axis]) / width), shape[axis] - 1)
        for x in range(cell[face, 0], cell[face, 2] + 1):
            for y in range(cell[face, 1], cell[face, 3] + 1):
                start[x * shape[1] + y + 1] += 1
    start = np.cumsum(start)
    members = np.empty(start[-1], np.int64)
    filled = start[:-1].copy()
    for face in range(len(faces)):
        for x in range(cell[face, 0], cell[face, 2] + 1):
            for y in range(cell[face, 1], cell[face, 3] + 1):
                members[filled[x * shape[1] + y]] = face
                filled[x * shape[1] + y] += 1
    return start, members


@njit(cache=True, parallel=True)
def _count(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, low: np.ndarray, width: float, shape: np.ndarray,
    start: np.ndarray, members: np.ndarray,
) -> np.ndarray:  # fmt: skip
    winding = np.zeros(len(points), np.int64)
    for index in prange(len(points)):
        point = points[index]
        x, y = int(np.floor((point[0] - low[0]) / width)), int(np.floor((point[1] - low[1]) / width))
        if x < 0 or y < 0 or x > shape[0] or y > shape[1]:
            continue
        column = min(x, shape[0] - 1) * shape[1] + min(y, shape[1] - 1)
        for member in range(start[column], start[column + 1]):
            winding[index] += _crossing(point, vertices, faces[members[member]])
    return winding


@njit(cache=True)
def _crossing(point: np.ndarray, vertices: np.ndarray, face: np.ndarray) -> int:
    """1 where the upward ray leaves through the face, -1 where it enters, 0 where it misses."""
    first, side_of_first = _side(point, vertices, face[1], face[2])
    second, side_of_second = _side(point, vertices, face[2], face[0])
    third, side_of_third = _side(point, vertices, face[0], face[1])
    if side_of_first != side_of_second or side_of_second != side_of_third:
        return 0
    area = first + second + third
    if area == 0.0:
        return 0
    height = (first * vertices[face[0], 2] + second * vertices[face[1], 2] + third * vertices[face[2], 2]) / area
    return side_of_first if height > point[2] else 0


@njit(cache=True)
def _side(point: np.ndarray, vertices: np.ndarray, a: int, b: int) -> tuple[float, int]:
    """Twice the area that an edge spans with the point, projected along z, and its sign.

    The edge is always taken from its lower vertex to its higher, so that both faces at it get the same sign, also
    from a point exactly in line. Products of float32 numbers' differences are exact in float64, hence the signs.
    """
    low, high = min(a, b), max(a, b)
    area = (vertices[high, 0] - vertices[low, 0]) * (point[1] - vertices[low, 1])
    area -= (vertices[high, 1] - vertices[low, 1]) * (point[0] - vertices[low, 0])
    side = 1 if area >= 0.0 else -1
    return (area, side) if a < b else (-area, -side)
