"""Nearest faces for points that are near a posed surface or in it, a few nanoseconds a face.

A grid of small cells lists the faces that a point in each cell could be under or close above. Unlike a tree it answers
most points at once, that nothing is near; unlike stored distances it is exact. Faces are listed only where points are:
made for one drape, it costs less than the drape. Distances without bounds are in `quaffure.geometry.signed_distance`.
Shapes cannot be checked at run time inside compiled code, hence `no_type_check`.
"""

from typing import NamedTuple, no_type_check

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.geometry.soft_surface import FAST
from quaffure.types import Float, Int, Tensor

CELL_SIZE, CELLS = 0.0125, 80
"""Side of a cell [m], and how many there are along each axis."""
CORNER = (-0.5, -0.5, -0.75)
"""Of the grid, from its centre [m]: hair hangs down."""
BESIDE = 0.001
"""How far beside a face a point may be under it [m]: more than rounding, where faces meet at an angle."""
AT_ONCE = 8
"""Faces that are compared without a branch; as long as a list's blocks."""
_BLOCK, _BLOCKS = 5, CELLS // 5  # cells along a side of the blocks of them that are marked
_ROOM = 1.5  # blocks of a list to begin with, for each face
_REFERENCE_PAIRS = 1_000_000  # point-face pairs that the twin holds in memory at once
_APART = 64  # rows between the rooms of threads, which would write into one line of the cache
_TIE = 0.99  # of faces about as near as each other, the one that a point is furthest above or below tells its side
# Columns of a face's record: normal, the directions along its first edge and across, each with its height at the face;
# length of that edge, third corner in the plane, inverse squared lengths of the other two edges; reach.
_NORMAL, _ALONG, _ACROSS, _LENGTH, _THIRD, _INVERSE, _REACH, _COLUMNS = 0, 4, 8, 12, 13, 15, 17, 20


class FaceGrid(NamedTuple):
    """Faces of one posed surface by cells.

    Attributes:
        origin: lowest corner [m].
        records: of each face, and of one that is near to nothing.
        first: of every cell the last block of its list; -1 where nothing is listed.
        following: of every block the next, or -1.
        faces: of every block.
    """

    origin: Float[np.ndarray, "3"]
    records: Float[np.ndarray, "face 20"]
    first: Int[np.ndarray, " cell"]
    following: Int[np.ndarray, " block"]
    faces: Int[np.ndarray, "block 8"]


def face_grid(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "k 3"],
    reach: Float[np.ndarray, "k 2"],
    points: Float[np.ndarray, "p 3"],
    centre: Float[np.ndarray, "3"],
) -> FaceGrid:
    """List the faces that lie within some centimetres of `points`.

    Args:
        vertices: float32 [m].
        reach: how far below and above each face points are told of it [m].
        points: float32 [m]; every second one is looked at.
    """
    threads, count = get_num_threads(), len(faces)
    origin = (centre + np.array(CORNER)).astype(np.float32)
    marked, first = np.empty((_BLOCKS,) * 3, np.uint8), np.empty(CELLS**3, np.int32)
    records, boxes = np.empty((count + 1, _COLUMNS), np.float32), np.empty((count, 6), np.int32)
    _mark(points, origin, marked)
    _measure(vertices, faces, reach, origin, marked, threads, records, boxes)
    room = int(_ROOM * count / threads) + 64
    while True:
        following, listed = np.empty(threads * room, np.int32), np.empty((threads * room, AT_ONCE), np.int32)
        if _list(records, boxes, threads, first, following, listed):
            return FaceGrid(origin, records, first, following, listed)
        room *= 2


def nearest_reached_reference(
    points: Float[Tensor, "p 3"],
    vertices: Float[Tensor, "v 3"],
    faces: Int[Tensor, "k 3"],
    reach: Float[Tensor, "k 2"],
) -> tuple[Float[Tensor, " p"], Int[Tensor, " p"]]:
    """Torch twin of `nearest_reached`: every point against every face.

    Returns:
        Height above the nearest face [m], and that face; 1 and -1 where none is reached.
    """
    chunk = max(1, _REFERENCE_PAIRS // len(faces))
    parts = [_nearest_of_all(part, vertices[faces], reach) for part in points.split(chunk)]
    return torch.cat([height for height, _ in parts]), torch.cat([face for _, face in parts])


def _nearest_of_all(
    points: Float[Tensor, "p 3"], corners: Float[Tensor, "k 3 3"], reach: Float[Tensor, "k 2"]
) -> tuple[Float[Tensor, " p"], Int[Tensor, " p"]]:
    a, b, c = corners.unbind(dim=1)
    along, normal = b - a, torch.linalg.cross(b - a, c - a)
    length = along.norm(dim=-1)
    along, normal = along / (length[:, None] + 1e-12), normal / (normal.norm(dim=-1, keepdim=True) + 1e-12)
    across = torch.linalg.cross(normal, along)
    offset = points[:, None] - a
    u, v, height = ((offset * direction).sum(-1) for direction in (along, across, normal))
    x, y = ((c - a) * along).sum(-1), ((c - a) * across).sum(-1)
    beside = (u - u.clamp(min=0).minimum(length)).square() + v.square()
    for start, end_x in ((0 * length, x), (length, x - length)):
        share = ((u - start) * end_x + v * y) / (end_x.square() + y.square() + 1e-24)
        share = share.clamp(0, 1)
        beside = beside.minimum((u - start - share * end_x).square() + (v - share * y).square())
    within = torch.minimum(v, torch.minimum(u * y - v * x, (x - length) * v - y * (u - length)))
    beside = torch.where(within < 0, beside, 0)
    reached = (height >= -reach[:, 0]) & (height <= reach[:, 1]) & (beside <= BESIDE**2)
    key, nearest = torch.where(reached, beside + _TIE * height.square(), 1).min(dim=1)
    chosen = height.gather(1, nearest[:, None])[:, 0]
    return torch.where(key < 1, chosen, 1), torch.where(key < 1, nearest, -1)


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def nearest_reached(x: float, y: float, z: float, grid: FaceGrid, rows: np.ndarray) -> tuple[float, int]:
    """Height of a point above the nearest of the faces that it is within reach of, and that face; 1 and -1 for none.

    Args:
        rows: room for twice `AT_ONCE` float32.
    """
    one, none = np.float32(1.0), np.float32(0.0)
    x, y, z = x - grid.origin[0], y - grid.origin[1], z - grid.origin[2]
    per_cell, best, height, face = one / np.float32(CELL_SIZE), one, one, -1
    if x < none or y < none or z < none:
        return height, face
    i, j, k = int(x * per_cell), int(y * per_cell), int(z * per_cell)
    if i >= CELLS or j >= CELLS or k >= CELLS:
        return height, face
    block = grid.first[(i * CELLS + j) * CELLS + k]
    while block >= 0:
        _compare(x, y, z, block, grid.faces, grid.records, rows)
        for lane in range(AT_ONCE):
            if rows[lane] < best:
                best, height, face = rows[lane], rows[AT_ONCE + lane], grid.faces[block, lane]
        block = grid.following[block]
    return height, face


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _compare(
    x: float, y: float, z: float, block: int, faces: np.ndarray, records: np.ndarray, rows: np.ndarray
) -> None:
    """Fill in the squared distances to a block of faces, 1 where they are out of reach, then the heights above them."""
    none, one, beyond = np.float32(0.0), np.float32(1.0), np.float32(BESIDE * BESIDE)
    for lane in range(AT_ONCE):
        face = records[faces[block, lane]]
        height = x * face[0] + y * face[1] + z * face[2] - face[3]
        u = x * face[_ALONG] + y * face[_ALONG + 1] + z * face[_ALONG + 2] - face[_ALONG + 3]
        v = x * face[_ACROSS] + y * face[_ACROSS + 1] + z * face[_ACROSS + 2] - face[_ACROSS + 3]
        length, cx, cy = face[_LENGTH], face[_THIRD], face[_THIRD + 1]
        du = u - min(max(u, none), length)
        beside = du * du + v * v
        share = min(max((u * cx + v * cy) * face[_INVERSE], none), one)
        du, dv = u - share * cx, v - share * cy
        beside = min(beside, du * du + dv * dv)
        bx, bu = cx - length, u - length
        share = min(max((bu * bx + v * cy) * face[_INVERSE + 1], none), one)
        du, dv = bu - share * bx, v - share * cy
        beside = min(beside, du * du + dv * dv)
        within = min(min(v, u * cy - v * cx), bx * v - cy * bu)
        beside = beside if within < none else none
        out = (height < -face[_REACH]) | (height > face[_REACH + 1]) | (beside > beyond)
        rows[lane] = one if out else beside + np.float32(_TIE) * height * height
        rows[AT_ONCE + lane] = height


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _mark(points: np.ndarray, origin: np.ndarray, marked: np.ndarray) -> None:
    """Mark the blocks of cells that every second point is in, and those next to them."""
    seen, per_block = np.zeros(marked.shape, np.uint8), np.float32(1.0 / (CELL_SIZE * _BLOCK))
    for index in range(0, len(points), 2):
        point = points[index]
        x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
        i, j, k = int(x * per_block), int(y * per_block), int(z * per_block)
        if min(x, min(y, z)) >= np.float32(0.0) and max(i, max(j, k)) < _BLOCKS:
            seen[i, j, k] = 1
    marked[:] = 0
    for i in range(_BLOCKS):
        for j in range(_BLOCKS):
            for k in range(_BLOCKS):
                if seen[i, j, k]:
                    marked[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2, max(k - 1, 0) : k + 2] = 1


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _measure(
    vertices: np.ndarray, faces: np.ndarray, reach: np.ndarray, origin: np.ndarray, marked: np.ndarray, threads: int,
    records: np.ndarray, boxes: np.ndarray,
) -> None:  # fmt: skip
    """Write records, relative to the origin, and the first and last cell along each axis of what faces reach.

    Faces away from the marked blocks are left out: their boxes are empty.
    """
    count, per_block = len(faces), np.float32(1.0 / (CELL_SIZE * _BLOCK))
    records[count] = np.float32(0.0)
    records[count, 3] = np.float32(-1.0)  # every point is out of its reach, above it
    room = np.empty((threads, _APART, 3), np.float32)
    for thread in prange(threads):
        corners = room[thread, :3]
        for face in range(thread * count // threads, (thread + 1) * count // threads):
            for corner in range(3):
                for axis in range(3):
                    corners[corner, axis] = vertices[faces[face, corner], axis] - origin[axis]
            boxes[face, 0], boxes[face, 1] = 1, 0
            x, y, z = corners[0]
            i, j, k = int(x * per_block), int(y * per_block), int(z * per_block)
            # A corner stands for its face: blocks are 6 cm wide, faces and their reach 5 cm.
            if min(x, min(y, z)) >= np.float32(0.0) and max(i, max(j, k)) < _BLOCKS and marked[i, j, k]:
                record = records[face]
                _write_record(corners, record)
                record[_REACH], record[_REACH + 1] = reach[face, 0], reach[face, 1]
                _write_box(corners, record, boxes[face])


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _write_record(corners: np.ndarray, record: np.ndarray) -> None:
    one, tiny = np.float32(1.0), np.float32(1e-24)
    ax, ay, az = corners[0]
    bx, by, bz = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    cx, cy, cz = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    length = np.sqrt(bx * bx + by * by + bz * bz)
    scale = one / (length + np.float32(1e-12))
    tx, ty, tz = bx * scale, by * scale, bz * scale
    nx, ny, nz = ty * cz - tz * cy, tz * cx - tx * cz, tx * cy - ty * cx
    scale = one / np.sqrt(nx * nx + ny * ny + nz * nz + tiny)
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    sx, sy, sz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    u, v = cx * tx + cy * ty + cz * tz, cx * sx + cy * sy + cz * sz
    record[0], record[1], record[2], record[3] = nx, ny, nz, ax * nx + ay * ny + az * nz
    record[_ALONG], record[_ALONG + 1], record[_ALONG + 2] = tx, ty, tz
    record[_ALONG + 3] = ax * tx + ay * ty + az * tz
    record[_ACROSS], record[_ACROSS + 1], record[_ACROSS + 2] = sx, sy, sz
    record[_ACROSS + 3] = ax * sx + ay * sy + az * sz
    record[_LENGTH], record[_THIRD], record[_THIRD + 1] = length, u, v
    record[_INVERSE] = one / (u * u + v * v + tiny)
    record[_INVERSE + 1] = one / ((u - length) * (u - length) + v * v + tiny)


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _write_box(corners: np.ndarray, record: np.ndarray, box: np.ndarray) -> None:
    per_cell, none = np.float32(1.0 / CELL_SIZE), np.float32(0.0)
    for axis in range(3):
        a, b, c, normal = corners[0, axis], corners[1, axis], corners[2, axis], record[_NORMAL + axis]
        below, above = -record[_REACH] * normal, record[_REACH + 1] * normal
        low = min(a, min(b, c)) + min(below, above) - np.float32(BESIDE)
        high = max(a, max(b, c)) + max(below, above) + np.float32(BESIDE)
        box[2 * axis] = int(max(low, none) * per_cell)
        box[2 * axis + 1] = min(int(max(high, none) * per_cell), CELLS - 1)


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _write_bounds(record: np.ndarray, bounds: np.ndarray) -> None:
    """Least and greatest height along a record's directions of the centres of cells that its face reaches into."""
    none, half, beside = np.float32(0.0), np.float32(0.5 * CELL_SIZE), np.float32(BESIDE)
    for side in range(3):
        direction = record[4 * side : 4 * side + 4]
        slack = half * (abs(direction[0]) + abs(direction[1]) + abs(direction[2]))
        bounds[side, 0], bounds[side, 1] = direction[3] - slack, direction[3] + slack
    u, v = record[_THIRD], record[_THIRD + 1]
    bounds[0, 0], bounds[0, 1] = bounds[0, 0] - record[_REACH], bounds[0, 1] + record[_REACH + 1]
    bounds[1, 0] = bounds[1, 0] + min(none, u) - beside
    bounds[1, 1] = bounds[1, 1] + max(record[_LENGTH], u) + beside
    bounds[2, 0], bounds[2, 1] = bounds[2, 0] - beside, bounds[2, 1] + v + beside


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _list(
    records: np.ndarray, boxes: np.ndarray, threads: int, first: np.ndarray, following: np.ndarray, blocks: np.ndarray
) -> bool:
    """List every face in the cells that it may reach into; False where there is no room for it."""
    room, count, plane, size = len(blocks) // threads, len(boxes), CELLS * CELLS, np.float32(CELL_SIZE)
    fits, places, spans = (
        np.ones(threads, np.uint8),
        np.zeros(len(blocks), np.int32),
        np.empty((threads, _APART, 2), np.float32),
    )
    for thread in prange(threads):
        used, bounds = thread * room, spans[thread, :3]
        for i in range(thread, CELLS, threads):
            first[i * plane : (i + 1) * plane] = -1
        for face in range(count):
            box, record = boxes[face], records[face]
            if box[1] >= box[0]:
                _write_bounds(record, bounds)
            for i in range(box[0] + (thread - box[0]) % threads, box[1] + 1, threads):
                x = (np.float32(i) + np.float32(0.5)) * size
                for j in range(box[2], box[3] + 1):
                    y = (np.float32(j) + np.float32(0.5)) * size
                    for k in range(box[4], box[5] + 1):
                        if not _reaches(x, y, (np.float32(k) + np.float32(0.5)) * size, record, bounds):
                            continue
                        cell = (i * CELLS + j) * CELLS + k
                        block = first[cell]
                        if block < 0 or places[block] == AT_ONCE:
                            if used == (thread + 1) * room:
                                fits[thread] = 0
                                continue
                            following[used], blocks[used], first[cell] = block, count, used
                            block, used = used, used + 1
                        blocks[block, places[block]] = face
                        places[block] += 1
    return fits.min() == 1


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _reaches(x: float, y: float, z: float, record: np.ndarray, bounds: np.ndarray) -> bool:
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
