"""Cells of space round a point that hold no part of a closed surface, nor come near it, and lie outside.

Most hair hangs free: one such look-up spares it the search for its nearest face. A cell is called clear only
if cells that no face comes near connect it to one that is known to be outside; points in all others are searched, so
the result is exact.

Cells that faces do come near are split into 4 x 4 x 4 small ones, one bit each. The flood goes on through small cells
that no face touches. Where it arrives a point is outside, so that no face beyond its margin need be found; and where
moreover no face comes near, it needs no search at all.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt64
from numba import njit

from quaffure.geometry.bvh import Bvh, nearest_face, search_workspace
from quaffure.geometry.triangle import closest_on_triangle, signed_distance_from_offset

CELLS = 64
"""Cells along each axis."""
CELL_SIZE = 0.02
"""Side of a cell [m]."""
FREE_DISTANCE = 0.005
"""A clear cell is at least this far from the surface [m]."""
ORIGIN = np.array([-0.64, -0.64, -0.80], np.float32)
"""Corner of the grid relative to the head [m]: hair hangs down."""
MOST_SPLIT = 16384
"""Cells that may be split; points in further ones are searched."""
FREE, OUTSIDE, UNKNOWN = 0, 1, 2
"""Results of `classify`."""
_FAR, _NOT_SPLIT = -1, -2  # no face is near the cell; one is, but `MOST_SPLIT` other cells are split
_SPLIT = 4
_SMALL = CELL_SIZE / _SPLIT
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
_ROUNDING = 1e-4  # a face this near to a small cell counts as touching it [m]
_STRIDES = np.array([16, 4, 1])


def _runs() -> UInt64[np.ndarray, "3 4 4"]:
    """Bits of the small cells of a cell whose coordinate along an axis is from `low` to `high`: [axis, low, high]."""
    coordinates = np.indices((_SPLIT, _SPLIT, _SPLIT)).reshape(3, -1)
    low, high = np.arange(_SPLIT)[:, None, None], np.arange(_SPLIT)[None, :, None]
    within = (coordinates[:, None, None] >= low) & (coordinates[:, None, None] <= high)
    bits: UInt64[np.ndarray, "3 4 4"] = np.packbits(within, axis=-1, bitorder="little").view(np.uint64)[..., 0]
    return bits


_RUNS = _runs()


class OccupancyGrid(NamedTuple):
    """Occupancy of space round a posed surface, or round each of a batch with one more axis in front.

    Attributes:
        origin: corner of the grid [m].
        clear: 1 where a cell is clear.
        slot: of a split cell its index in `outside` and `free`; negative elsewhere.
        outside: bit 16 x + 4 y + z of a split cell is set where its small cell (x, y, z) is outside.
        free: the same, where moreover it is at least `FREE_DISTANCE` from the surface.
    """

    origin: np.ndarray
    clear: np.ndarray
    slot: np.ndarray
    outside: np.ndarray
    free: np.ndarray


def allocate_occupancy_grid(centres: Float[np.ndarray, "b 3"]) -> OccupancyGrid:
    """Grids round points [m], for `fill_occupancy_grid` to fill."""
    grid, split = (len(centres), CELLS, CELLS, CELLS), (len(centres), MOST_SPLIT)
    return OccupancyGrid(
        centres + ORIGIN,
        np.empty(grid, np.uint8),
        np.empty(grid, np.int32),
        np.empty(split, np.uint64),
        np.empty(split, np.uint64),
    )


@njit(cache=True)
def fill_occupancy_grid(corners: np.ndarray, normals: np.ndarray, tree: Bvh, space: OccupancyGrid) -> None:
    """Fill all but the origin."""
    cells = _number_near_cells(corners, space.origin, space.slot)
    _flood_clear(corners, normals, tree, space)
    count = len(cells)
    open_cells, far = space.outside[:count], space.free[:count]
    open_cells[:], far[:] = _ALL, _ALL
    _clear_touched(corners, space.origin, space.slot, _ROUNDING, open_cells)
    _clear_touched(corners, space.origin, space.slot, FREE_DISTANCE, far)
    outside = _flood_small(cells, space.clear, space.slot, open_cells)
    for index in range(count):
        open_cells[index] = outside[index]
        far[index] &= outside[index]


@njit(cache=True)
def _flood_clear(corners: np.ndarray, normals: np.ndarray, tree: Bvh, space: OccupancyGrid) -> None:
    """Fill `clear`, given `slot`, from those corners of the grid that are outside."""
    clear, slot = space.clear, space.slot
    clear[:] = 0
    stack = np.empty((CELLS**3, 3), np.int32)
    last = CELLS - 1
    for seed in range(8):
        ix, iy, iz, top = last * (seed & 1), last * ((seed >> 1) & 1), last * (1 - (seed >> 2)), 0
        x, y, z = (
            space.origin[0] + (ix + 0.5) * CELL_SIZE,
            space.origin[1] + (iy + 0.5) * CELL_SIZE,
            space.origin[2] + (iz + 0.5) * CELL_SIZE,
        )
        if slot[ix, iy, iz] == _FAR and clear[ix, iy, iz] == 0 and _is_outside(x, y, z, corners, normals, tree):
            clear[ix, iy, iz] = 1
            stack[0, 0], stack[0, 1], stack[0, 2], top = ix, iy, iz, 1
        while top > 0:
            top -= 1
            ix, iy, iz = stack[top, 0], stack[top, 1], stack[top, 2]
            for side in range(6):
                jx, jy, jz = _neighbour(ix, iy, iz, side)
                if _on_grid(jx, jy, jz) and slot[jx, jy, jz] == _FAR and clear[jx, jy, jz] == 0:
                    clear[jx, jy, jz] = 1
                    stack[top, 0], stack[top, 1], stack[top, 2] = jx, jy, jz
                    top += 1


@njit(cache=True)
def _is_outside(x: float, y: float, z: float, corners: np.ndarray, normals: np.ndarray, tree: Bvh) -> bool:
    """Whether a point is outside, by the exact signed distance."""
    stack, scratch = search_workspace()
    # Arguments of the types that all searches have: numba compiles once for each combination.
    at, anywhere = (np.float32(x), np.float32(y), np.float32(z)), np.float32(np.inf)
    leaf = nearest_face(at[0], at[1], at[2], int(np.int64(0)), anywhere, tree, stack, scratch)
    cx, cy, cz, feature = closest_on_triangle(corners[leaf], x, y, z)
    nx, ny, nz = normals[leaf, feature]
    return signed_distance_from_offset(x - cx, y - cy, z - cz, nx, ny, nz)[0] > 0.0


@njit(cache=True, fastmath=True, inline="always")
def is_clear(x: float, y: float, z: float, space: OccupancyGrid) -> bool:
    """Whether a point lies in a clear cell, `FREE_DISTANCE` from the surface at least; points off the grid do not."""
    scale = np.float32(1.0 / CELL_SIZE)
    fx, fy, fz = (x - space.origin[0]) * scale, (y - space.origin[1]) * scale, (z - space.origin[2]) * scale
    if fx < 0 or fy < 0 or fz < 0 or fx >= CELLS or fy >= CELLS or fz >= CELLS:
        return False
    return space.clear[int(fx), int(fy), int(fz)] == 1


@njit(cache=True, fastmath=True, inline="always")
def classify(x: float, y: float, z: float, space: OccupancyGrid) -> int:
    """`FREE`: outside, at least `FREE_DISTANCE` from the surface. `OUTSIDE`: outside. `UNKNOWN`: anywhere."""
    scale = np.float32(1.0 / _SMALL)
    fx, fy, fz = (x - space.origin[0]) * scale, (y - space.origin[1]) * scale, (z - space.origin[2]) * scale
    most = CELLS * _SPLIT
    if fx < 0 or fy < 0 or fz < 0 or fx >= most or fy >= most or fz >= most:
        return UNKNOWN
    ix, iy, iz = int(fx), int(fy), int(fz)
    if space.clear[ix >> 2, iy >> 2, iz >> 2] == 1:
        return FREE
    slot = space.slot[ix >> 2, iy >> 2, iz >> 2]
    if slot < 0:
        return UNKNOWN
    bit = np.uint64(1) << np.uint64(16 * (ix & 3) + 4 * (iy & 3) + (iz & 3))
    if space.free[slot] & bit:
        return FREE
    return OUTSIDE if space.outside[slot] & bit else UNKNOWN


@njit(cache=True)
def _number_near_cells(corners: np.ndarray, origin: np.ndarray, slot: np.ndarray) -> np.ndarray:
    """Number the cells that the box of a face, enlarged by `FREE_DISTANCE`, meets; return their coordinates."""
    cells = np.empty((MOST_SPLIT, 3), np.int32)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    slot[:] = _FAR
    count = 0
    for face in range(len(corners)):
        if not _small_range(corners[face], origin, FREE_DISTANCE, low, high):
            continue
        for ix in range(low[0] >> 2, (high[0] >> 2) + 1):
            for iy in range(low[1] >> 2, (high[1] >> 2) + 1):
                for iz in range(low[2] >> 2, (high[2] >> 2) + 1):
                    if slot[ix, iy, iz] == _FAR and count == MOST_SPLIT:
                        slot[ix, iy, iz] = _NOT_SPLIT
                    elif slot[ix, iy, iz] == _FAR:
                        slot[ix, iy, iz] = count
                        cells[count, 0], cells[count, 1], cells[count, 2] = ix, iy, iz
                        count += 1
    return cells[:count]


@njit(cache=True, inline="always")
def _small_range(face: np.ndarray, origin: np.ndarray, growth: float, low: np.ndarray, high: np.ndarray) -> bool:
    """Write the small cells that the box of a face, enlarged by `growth` [m], meets; False where there are none."""
    meets = True
    for axis in range(3):
        a, b, c = face[0, axis], face[1, axis], face[2, axis]
        low[axis] = max(0, int(np.floor((min(a, b, c) - growth - origin[axis]) / _SMALL)))
        high[axis] = min(_SPLIT * CELLS - 1, int(np.floor((max(a, b, c) + growth - origin[axis]) / _SMALL)))
        meets = meets and low[axis] <= high[axis]
    return meets


@njit(cache=True)
def _clear_touched(corners: np.ndarray, origin: np.ndarray, slot: np.ndarray, growth: float, words: np.ndarray) -> None:
    """Clear the bits of all small cells that the box of a face, enlarged by `growth` [m], meets."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for face in range(len(corners)):
        if not _small_range(corners[face], origin, growth, low, high):
            continue
        for ix in range(low[0] >> 2, (high[0] >> 2) + 1):
            in_x = _RUNS[0, max(0, low[0] - _SPLIT * ix), min(_SPLIT - 1, high[0] - _SPLIT * ix)]
            for iy in range(low[1] >> 2, (high[1] >> 2) + 1):
                in_y = _RUNS[1, max(0, low[1] - _SPLIT * iy), min(_SPLIT - 1, high[1] - _SPLIT * iy)]
                for iz in range(low[2] >> 2, (high[2] >> 2) + 1):
                    in_z = _RUNS[2, max(0, low[2] - _SPLIT * iz), min(_SPLIT - 1, high[2] - _SPLIT * iz)]
                    at = slot[ix, iy, iz]
                    if at >= 0:
                        words[at] &= ~(in_x & in_y & in_z)


@njit(cache=True)
def _flood_small(cells: np.ndarray, clear: np.ndarray, slot: np.ndarray, open_cells: np.ndarray) -> np.ndarray:
    """Bits of the open small cells that the sides of open ones connect to clear cells."""
    count = len(cells)
    outside = np.zeros(count, np.uint64)
    waits = np.ones(count, np.bool_)
    stack = np.arange(count)
    top = count
    for index in range(count):
        for side in range(6):
            jx, jy, jz = _neighbour(cells[index, 0], cells[index, 1], cells[index, 2], side)
            if _on_grid(jx, jy, jz) and clear[jx, jy, jz] == 1:
                outside[index] |= _across(_ALL, side ^ 1) & open_cells[index]
    while top > 0:
        top -= 1
        index = stack[top]
        waits[index] = False
        if outside[index] == 0:
            continue
        outside[index] = _spread(outside[index], open_cells[index])
        for side in range(6):
            jx, jy, jz = _neighbour(cells[index, 0], cells[index, 1], cells[index, 2], side)
            other = slot[jx, jy, jz] if _on_grid(jx, jy, jz) else -1
            if other < 0:
                continue
            new = _across(outside[index], side) & open_cells[other] & ~outside[other]
            if new != 0:
                outside[other] |= new
                if not waits[other]:
                    waits[other] = True
                    stack[top] = other
                    top += 1
    return outside


@njit(cache=True, inline="always")
def _neighbour(ix: int, iy: int, iz: int, side: int) -> tuple[int, int, int]:
    """The cell at a side: 0 and 1 are +x and -x, 2 and 3 along y, 4 and 5 along z."""
    step, axis = 1 - 2 * (side & 1), side >> 1
    return ix + step * (axis == 0), iy + step * (axis == 1), iz + step * (axis == 2)


@njit(cache=True, inline="always")
def _on_grid(ix: int, iy: int, iz: int) -> bool:
    return ix >= 0 and iy >= 0 and iz >= 0 and ix < CELLS and iy < CELLS and iz < CELLS


@njit(cache=True, inline="always")
def _across(bits: np.uint64, side: int) -> np.uint64:
    """What the small cells along a side of a cell become in the neighbour there."""
    axis = side >> 1
    stride = np.uint64((_SPLIT - 1) * _STRIDES[axis])
    if side & 1 == 0:
        return (bits & _RUNS[axis, _SPLIT - 1, _SPLIT - 1]) >> stride
    return (bits & _RUNS[axis, 0, 0]) << stride


@njit(cache=True, inline="always")
def _spread(bits: np.uint64, open_bits: np.uint64) -> np.uint64:
    """Flood inside a cell, all small cells at once."""
    while True:
        wider = bits
        for axis in range(3):
            stride = np.uint64(_STRIDES[axis])
            wider |= (bits & _RUNS[axis, 0, _SPLIT - 2]) << stride
            wider |= (bits & _RUNS[axis, 1, _SPLIT - 1]) >> stride
        wider &= open_bits
        if wider == bits:
            return bits
        bits = wider
