"""Cells of space round a point that hold no part of a closed surface, nor come near it, and lie outside.

Most hair hangs free: one look into such a cell spares it the search for its nearest face. A cell is called clear only
if it is reached, through cells that no face comes near, from one that is known to be outside; whatever is not reached
is searched, so the answer is exact.
"""

import numpy as np
from numba import njit

from quaffure.geometry.face_tree import MAX_DEPTH, closest_on_triangle, search

CELLS = 64
"""Cells along each axis."""
CELL_SIZE = 0.02
"""Side of a cell [m]."""
REACH = 0.005
"""A clear cell is at least this far from the surface [m]."""
ORIGIN = np.array([-0.64, -0.64, -0.80], np.float32)
"""Corner of the grid relative to the head [m]: hair hangs down."""


@njit(cache=True)
def find_clear_cells(
    corners: np.ndarray,
    normals: np.ndarray,
    bounds: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    origin: np.ndarray,
    clear: np.ndarray,
) -> None:
    """Fill `clear` [64, 64, 64] with 1 where a cell of the grid at `origin` is clear, else 0."""
    near = np.zeros((CELLS, CELLS, CELLS), np.uint8)
    _mark_near(corners, origin, near)
    clear[:] = 0
    stack = np.empty(CELLS**3, np.int32)
    top = 0
    for seed in range(8):
        ix, iy, iz = (CELLS - 1) * (seed & 1), (CELLS - 1) * ((seed >> 1) & 1), (CELLS - 1) * (1 - (seed >> 2))
        if (
            near[ix, iy, iz] == 0
            and clear[ix, iy, iz] == 0
            and _outside(origin, ix, iy, iz, corners, normals, bounds, first, second)
        ):
            clear[ix, iy, iz] = 1
            stack[top] = (ix * CELLS + iy) * CELLS + iz
            top += 1
        while top > 0:
            top -= 1
            cell = stack[top]
            for side in range(6):
                step = 1 if side < 3 else -1
                axis = side % 3
                jx = cell // (CELLS * CELLS) + (step if axis == 0 else 0)
                jy = (cell // CELLS) % CELLS + (step if axis == 1 else 0)
                jz = cell % CELLS + (step if axis == 2 else 0)
                if jx < 0 or jy < 0 or jz < 0 or jx >= CELLS or jy >= CELLS or jz >= CELLS:
                    continue
                if near[jx, jy, jz] == 0 and clear[jx, jy, jz] == 0:
                    clear[jx, jy, jz] = 1
                    stack[top] = (jx * CELLS + jy) * CELLS + jz
                    top += 1


@njit(cache=True)
def _mark_near(corners: np.ndarray, origin: np.ndarray, near: np.ndarray) -> None:
    """Mark every cell that the box of a face, grown by `REACH`, meets."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for face in range(len(corners)):
        meets = True
        for axis in range(3):
            a, b, c = corners[face, 0, axis], corners[face, 1, axis], corners[face, 2, axis]
            low[axis] = np.floor((min(a, b, c) - REACH - origin[axis]) / CELL_SIZE)
            high[axis] = np.floor((max(a, b, c) + REACH - origin[axis]) / CELL_SIZE)
            meets = meets and high[axis] >= 0 and low[axis] < CELLS
        if not meets:
            continue
        for ix in range(max(0, low[0]), min(CELLS, high[0] + 1)):
            for iy in range(max(0, low[1]), min(CELLS, high[1] + 1)):
                for iz in range(max(0, low[2]), min(CELLS, high[2] + 1)):
                    near[ix, iy, iz] = 1


@njit(cache=True)
def _outside(
    origin: np.ndarray, ix: int, iy: int, iz: int, corners: np.ndarray, normals: np.ndarray, bounds: np.ndarray,
    first: np.ndarray, second: np.ndarray,
) -> bool:  # fmt: skip
    """Whether the middle of a cell is outside, by the exact signed distance."""
    point = np.empty(3, np.float32)
    point[0] = origin[0] + (ix + 0.5) * CELL_SIZE
    point[1] = origin[1] + (iy + 0.5) * CELL_SIZE
    point[2] = origin[2] + (iz + 0.5) * CELL_SIZE
    place = search(point, 0, corners, bounds, first, second, np.empty(MAX_DEPTH, np.int32))
    cx, cy, cz, feature = closest_on_triangle(corners[place], point[0], point[1], point[2])
    normal = normals[place, feature]
    return (point[0] - cx) * normal[0] + (point[1] - cy) * normal[1] + (point[2] - cz) * normal[2] > 0.0


@njit(cache=True, fastmath=True, inline="always")
def is_clear(x: float, y: float, z: float, origin: np.ndarray, clear: np.ndarray) -> bool:
    """Whether a point lies in a clear cell; points off the grid do not."""
    scale = np.float32(1.0 / CELL_SIZE)
    fx, fy, fz = (x - origin[0]) * scale, (y - origin[1]) * scale, (z - origin[2]) * scale
    if fx < 0 or fy < 0 or fz < 0 or fx >= CELLS or fy >= CELLS or fz >= CELLS:
        return False
    return clear[int(fx), int(fy), int(fz)] == 1
