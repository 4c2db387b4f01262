"""Nearest faces for points that are close to a posed surface or in it, a few nanoseconds a face.

A grid of small cells lists the faces that a point in each cell could be under, or close above, within the band of each
face. Unlike a tree it finds for most points at once that nothing is near; unlike stored distances it is exact, but for
points that are outside the prisms over all faces, at ridges and in hollows (`EDGE_TOLERANCE`). Faces are listed
only round the points that the grid is made for, which costs less than a drape. Distances without bounds are in
`quaffure.geometry.signed_distance`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import get_num_threads, njit, prange

from quaffure.geometry.mls_kernels import FAST
from quaffure.geometry.triangle import face_frame, squared_distance_in_plane

CELL_SIZE, CELLS = 0.0125, 80
"""Side of a cell [m], and how many there are along each axis."""
CORNER = (-0.5, -0.5, -0.75)
"""The grid's lowest corner, from its centre [m]: hair hangs down."""
EDGE_TOLERANCE = 0.001
"""How far outside the prism over a face a point may be and still count as under it [m]: at a ridge or in a hollow a
point can be outside all prisms, and finds no face. More would let faces beyond a ridge claim points outside."""
IN_BLOCK = 8
"""Faces that are compared without a branch; as long as a list's blocks."""
NONE, OUT_OF_BAND = -1, -2
"""In place of a face: none is near; not searched."""
_WIDE, _REGIONS = 5, CELLS // 5  # cells along a side of a region, in all of which faces are listed or in none; regions
_BLOCKS_PER_FACE = 2.0  # blocks of lists to begin with, for each face
FLAT = 1e-10  # faces with a smaller area are left out: their normals are rounding [m^2]
_APART = 64  # rows between the workspaces of threads, which would write into one line of the cache
TIE = 0.99  # of faces about as near as each other, the one that a point is furthest above or below tells its side
# Columns of a face's record: normal, the directions along its first edge and across, each with its height at the face;
# length of that edge, third corner in the plane, inverse squared lengths of the other two edges; band.
_ALONG, _ACROSS, _LENGTH, _THIRD, _INVERSE, _BAND, _COLUMNS = 4, 8, 12, 13, 15, 17, 20


class TriangleGrid(NamedTuple):
    """Faces of one posed surface by cells.

    Attributes:
        origin: lowest corner [m].
        records: of each face, and of one that is near to nothing.
        first: of every cell the last block of its list; `NONE` without one, `OUT_OF_BAND` away from the grid's points.
        next_block: of every block the next, or `NONE`.
        faces: of every block.
    """

    origin: Float[np.ndarray, "3"]
    records: Float[np.ndarray, "face 20"]
    first: Int[np.ndarray, " cell"]
    next_block: Int[np.ndarray, " block"]
    faces: Int[np.ndarray, "block 8"]


def triangle_grid(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "k 3"],
    band: Float[np.ndarray, "k 2"],
    centre: Float[np.ndarray, "3"],
    points: Float[np.ndarray, "p 3"] | None = None,
) -> TriangleGrid:
    """List faces, those near `points` or all.

    Args:
        vertices: finite, float32 [m].
        band: how far below and above each face it counts for points [m].
        centre: of the grid, see `CORNER` [m].
        points: finite, float32 [m]; every second one is used.
    """
    threads, count = get_num_threads(), len(faces)
    origin = (centre + np.array(CORNER)).astype(np.float32)
    marked, first = np.ones((_REGIONS,) * 3, np.uint8), np.empty(CELLS**3, np.int32)
    if points is not None:
        _mark(points, origin, marked)
    records, boxes = np.empty((count + 1, _COLUMNS), np.float32), np.empty((count, 6), np.int32)
    _measure(vertices, faces, band, origin, marked, threads, records, boxes)
    capacity = int(_BLOCKS_PER_FACE * count / threads) + 64
    while True:
        next_block, blocks = np.empty(threads * capacity, np.int32), np.empty((threads * capacity, IN_BLOCK), np.int32)
        if _list(records, boxes, marked, threads, first, next_block, blocks):
            return TriangleGrid(origin, records, first, next_block, blocks)
        capacity *= 2


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def nearest_triangle_in_band(x: float, y: float, z: float, grid: TriangleGrid, rows: np.ndarray) -> tuple[float, int]:
    """Height of a point above the nearest face whose band it is in, and that face; 1 and `NONE` or `OUT_OF_BAND`.

    Args:
        x, y, z: finite, and less than 1e6 m, since they become integers.
        rows: memory for twice `IN_BLOCK` float32.
    """
    one, none = np.float32(1.0), np.float32(0.0)
    x, y, z = x - grid.origin[0], y - grid.origin[1], z - grid.origin[2]
    per_cell, best, height, face = one / np.float32(CELL_SIZE), one, one, NONE
    if x < none or y < none or z < none:
        return height, face
    i, j, k = int(x * per_cell), int(y * per_cell), int(z * per_cell)
    if i >= CELLS or j >= CELLS or k >= CELLS:
        return height, face
    block = grid.first[(i * CELLS + j) * CELLS + k]
    if block == OUT_OF_BAND:
        return height, OUT_OF_BAND
    while block >= 0:
        _compare(x, y, z, block, grid.faces, grid.records, rows)
        for lane in range(IN_BLOCK):
            if rows[lane] < best:
                best, height, face = rows[lane], rows[IN_BLOCK + lane], grid.faces[block, lane]
        block = grid.next_block[block]
    return height, face


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _compare(
    x: float, y: float, z: float, block: int, faces: np.ndarray, records: np.ndarray, rows: np.ndarray
) -> None:
    """Fill in the squared distances to a block of faces, 1 where out of their bands, then the heights above them."""
    one, beyond = np.float32(1.0), np.float32(EDGE_TOLERANCE * EDGE_TOLERANCE)
    for lane in range(IN_BLOCK):
        face = records[faces[block, lane]]
        height = x * face[0] + y * face[1] + z * face[2] - face[3]
        u = x * face[_ALONG] + y * face[_ALONG + 1] + z * face[_ALONG + 2] - face[_ALONG + 3]
        v = x * face[_ACROSS] + y * face[_ACROSS + 1] + z * face[_ACROSS + 2] - face[_ACROSS + 3]
        in_plane = squared_distance_in_plane(
            u, v, face[_LENGTH], face[_THIRD], face[_THIRD + 1], face[_INVERSE], face[_INVERSE + 1]
        )
        out = (height < -face[_BAND]) | (height > face[_BAND + 1]) | (in_plane > beyond)
        rows[lane] = one if out else in_plane + np.float32(TIE) * height * height
        rows[IN_BLOCK + lane] = height


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _mark(points: np.ndarray, origin: np.ndarray, marked: np.ndarray) -> None:
    """Mark the regions that every second point is in, and those next to them."""
    seen, per_region = np.zeros(marked.shape, np.uint8), np.float32(1.0 / (CELL_SIZE * _WIDE))
    for index in range(0, len(points), 2):
        point = points[index]
        x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
        i, j, k = int(x * per_region), int(y * per_region), int(z * per_region)
        if min(x, min(y, z)) >= np.float32(0.0) and max(i, max(j, k)) < _REGIONS:
            seen[i, j, k] = 1
    marked[:] = 0
    for i in range(_REGIONS):
        for j in range(_REGIONS):
            for k in range(_REGIONS):
                if seen[i, j, k]:
                    marked[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2, max(k - 1, 0) : k + 2] = 1


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _measure(
    vertices: np.ndarray, faces: np.ndarray, band: np.ndarray, origin: np.ndarray, marked: np.ndarray, threads: int,
    records: np.ndarray, boxes: np.ndarray,
) -> None:  # fmt: skip
    """Write records, relative to the origin, and the first and last cell along each axis of the faces' bands.

    Faces whose bands meet no marked region are left out: their boxes are empty.
    """
    count, workspaces = len(faces), np.empty((threads, _APART, 3), np.float32)
    records[count] = np.float32(0.0)
    records[count, 3] = np.float32(-1.0)  # every point is above its band
    for thread in prange(threads):
        corners, down, up = workspaces[thread, :3], workspaces[thread, 3], workspaces[thread, 4]
        for face in range(thread * count // threads, (thread + 1) * count // threads):
            for corner in range(3):
                for axis in range(3):
                    corners[corner, axis] = vertices[faces[face, corner], axis] - origin[axis]
            record, box, below, above = records[face], boxes[face], band[face, 0], band[face, 1]
            up[:] = max(below, above)  # whatever way the face is oriented
            _write_box(corners, up, up, box)
            if _meets(box, marked) and _write_record(corners, record):
                record[_BAND], record[_BAND + 1] = below, above
                for axis in range(3):
                    down[axis] = max(below * record[axis], -above * record[axis])
                    up[axis] = max(above * record[axis], -below * record[axis])
                _write_box(corners, down, up, box)
            else:
                box[0], box[1] = 1, 0


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _write_box(corners: np.ndarray, down: np.ndarray, up: np.ndarray, box: np.ndarray) -> None:
    """First and last cell along each axis of a face extended `down` and `up` along each."""
    per_cell, none, last = np.float32(1.0 / CELL_SIZE), np.float32(0.0), np.float32(CELLS - 1)
    for axis in range(3):
        a, b, c = corners[0, axis], corners[1, axis], corners[2, axis]
        low = (min(a, min(b, c)) - down[axis] - np.float32(EDGE_TOLERANCE)) * per_cell
        high = (max(a, max(b, c)) + up[axis] + np.float32(EDGE_TOLERANCE)) * per_cell
        box[2 * axis] = int(min(max(low, none), last + np.float32(1.0)))
        box[2 * axis + 1] = int(min(max(high, np.float32(-1.0)), last))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _meets(box: np.ndarray, marked: np.ndarray) -> bool:
    met = False
    for i in range(box[0] // _WIDE, box[1] // _WIDE + 1):
        for j in range(box[2] // _WIDE, box[3] // _WIDE + 1):
            for k in range(box[4] // _WIDE, box[5] // _WIDE + 1):
                met |= marked[i, j, k] != 0
    return met


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _write_record(corners: np.ndarray, record: np.ndarray) -> bool:
    """Write all columns but the band; False for a face without area."""
    frame = face_frame(corners)
    for side in range(3):
        x, y, z = frame[3 * side], frame[3 * side + 1], frame[3 * side + 2]
        record[4 * side], record[4 * side + 1], record[4 * side + 2] = x, y, z
        record[4 * side + 3] = corners[0, 0] * x + corners[0, 1] * y + corners[0, 2] * z
    for column in range(_BAND - _LENGTH):
        record[_LENGTH + column] = frame[9 + column]
    return frame[14] > np.float32(2 * FLAT)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _write_bounds(record: np.ndarray, bounds: np.ndarray) -> None:
    """Least and greatest height along a record's directions of the centres of cells that its face's band meets."""
    none, half, in_plane = np.float32(0.0), np.float32(0.5 * CELL_SIZE), np.float32(EDGE_TOLERANCE)
    for side in range(3):
        direction = record[4 * side : 4 * side + 4]
        slack = half * (abs(direction[0]) + abs(direction[1]) + abs(direction[2]))
        bounds[side, 0], bounds[side, 1] = direction[3] - slack, direction[3] + slack
    u, v = record[_THIRD], record[_THIRD + 1]
    bounds[0, 0], bounds[0, 1] = bounds[0, 0] - record[_BAND], bounds[0, 1] + record[_BAND + 1]
    bounds[1, 0] = bounds[1, 0] + min(none, u) - in_plane
    bounds[1, 1] = bounds[1, 1] + max(record[_LENGTH], u) + in_plane
    bounds[2, 0], bounds[2, 1] = bounds[2, 0] - in_plane, bounds[2, 1] + v + in_plane


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _list(
    records: np.ndarray, boxes: np.ndarray, marked: np.ndarray, threads: int,
    first: np.ndarray, next_block: np.ndarray, blocks: np.ndarray,
) -> bool:  # fmt: skip
    """List every face in the cells of marked regions that its band may meet; False where there is not enough memory."""
    capacity, count, size, half = len(blocks) // threads, len(boxes), np.float32(CELL_SIZE), np.float32(0.5)
    fits, filled = np.ones(threads, np.uint8), np.zeros(len(blocks), np.int32)
    workspaces = np.empty((threads, _APART, 2), np.float32)
    for thread in prange(threads):  # each has the planes of cells that are its own, all of their lists and their blocks
        used, bounds = thread * capacity, workspaces[thread, :3]
        for i in range(thread, CELLS, threads):
            _clear(i, marked, first)
        for face in range(count):
            box, record = boxes[face], records[face]
            if box[1] >= box[0]:
                _write_bounds(record, bounds)
            for i in range(box[0] + (thread - box[0]) % threads, box[1] + 1, threads):
                x = (np.float32(i) + half) * size
                for j in range(box[2], box[3] + 1):
                    y = (np.float32(j) + half) * size
                    for k in range(box[4], box[5] + 1):
                        if not _is_within(x, y, (np.float32(k) + half) * size, record, bounds):
                            continue
                        cell = (i * CELLS + j) * CELLS + k
                        block = first[cell]
                        if block == OUT_OF_BAND:
                            continue
                        if block < 0 or filled[block] == IN_BLOCK:
                            if used == (thread + 1) * capacity:
                                fits[thread] = 0
                                continue
                            next_block[used], blocks[used], first[cell] = block, count, used
                            block, used = used, used + 1
                        blocks[block, filled[block]] = face
                        filled[block] += 1
    return fits.min() == 1


@njit(cache=True)
def _clear(i: int, marked: np.ndarray, first: np.ndarray) -> None:
    """Empty the lists of a plane of cells."""
    for j in range(CELLS):
        for region in range(_REGIONS):
            begin = (i * CELLS + j) * CELLS + region * _WIDE
            first[begin : begin + _WIDE] = NONE if marked[i // _WIDE, j // _WIDE, region] else OUT_OF_BAND


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _is_within(x: float, y: float, z: float, record: np.ndarray, bounds: np.ndarray) -> bool:
    height = x * record[0] + y * record[1] + z * record[2]
    u = x * record[_ALONG] + y * record[_ALONG + 1] + z * record[_ALONG + 2]
    v = x * record[_ACROSS] + y * record[_ACROSS + 1] + z * record[_ACROSS + 2]
    return (
        (height >= bounds[0, 0])
        & (height <= bounds[0, 1])
        & (u >= bounds[1, 0])
        & (u <= bounds[1, 1])
        & (v >= bounds[2, 0])
        & (v <= bounds[2, 1])
    )
