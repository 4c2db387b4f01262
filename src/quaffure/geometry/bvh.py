"""Bounding volume hierarchy over the faces of a mesh, sixteen children a node and sixteen faces a block.

Boxes and faces are stored one array a number, so that the compiler tests all children or faces of a node abreast: three
to four times as fast as a binary tree. The order of the faces is made once for a topology and valid in every pose; the
boxes are refitted to each.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange

from quaffure.geometry.triangle import face_frame, squared_distance, squared_distance_in_plane

LANES = 16
"""Children of a node and faces of a block."""
_STACK_SIZE = 128  # 15 nodes wait a level, and 16^8 faces have eight levels
_LEAF_SIZE = 4  # faces that the order does not separate any further
_BLOCK_ROWS = 17
_BOX_ROWS = 11
_ROUNDING = 1e-6  # of a height along a slab's direction, in float32 [m]
_FAR = 1e9  # how far away missing children are [m]; they are never visited, since children are counted


class Bvh(NamedTuple):
    """The tree in one pose, or in a batch of poses with one more axis in front.

    Attributes:
        blocks: each face's first corner and `face_frame` but for the area; [17, lane] a block, flat.
        boxes: of a node's children the lower and upper corners, and a slab: unit direction, least and greatest
            height along it; [11, lane] a node, flat [m]. Of blocks the direction is their mean normal, for a patch of
            skin is thin that way; of nodes the slab is all of space.
        levels: the first node of every level from the lowest up, then the number of nodes, then that of faces. The
            children of the lowest level are blocks of `LANES` faces.
    """

    blocks: np.ndarray
    boxes: np.ndarray
    levels: np.ndarray


def leaf_order(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
    """Faces in an order in which every block, and every node of the tree, is a compact piece of the surface.

    Centroids are split along their widest axis, over and over, in halves of whole blocks.
    """
    centroids = vertices[faces].mean(axis=1)
    order = np.arange(len(faces), dtype=np.int32)
    pending = [(0, len(faces))]
    while pending:
        start, stop = pending.pop()
        if stop - start <= _LEAF_SIZE:
            continue
        part = centroids[order[start:stop]]
        axis = int(np.argmax(part.max(axis=0) - part.min(axis=0)))
        middle = start + _left_share(stop - start)
        order[start:stop] = order[start:stop][np.argpartition(part[:, axis], middle - start)]
        pending += [(start, middle), (middle, stop)]
    return order


def _left_share(count: int) -> int:
    """How many of `count` faces go left: half, in the largest power of `LANES` that splits them."""
    if count <= LANES:
        return count // 2
    unit = LANES
    while unit * LANES < count:
        unit *= LANES
    return unit * max(1, -(-count // unit) // 2)


def bvh_levels(face_count: int) -> Int[np.ndarray, " l"]:
    """`Bvh.levels` of a mesh of so many faces."""
    children = -(-face_count // LANES)
    starts = [0]
    while len(starts) == 1 or children > 1:
        children = -(-children // LANES)
        starts.append(starts[-1] + children)
    return np.array([*starts, face_count], np.int64)


@njit(cache=True, inline="always")
def search_workspace() -> tuple[np.ndarray, np.ndarray]:
    """Stack and scratch memory of searches, one pair a thread."""
    return np.empty(_STACK_SIZE, np.int32), np.empty(_STACK_SIZE + 2 * LANES, np.float32)


@njit(cache=True, parallel=True, fastmath=True)
def search_all(points: np.ndarray, corners: np.ndarray, tree: Bvh) -> np.ndarray:
    """Leaves (positions in the leaf order) of the faces nearest to `points` [p, 3].

    Neighbours in the list should be neighbours in space.
    """
    count = len(points)
    leaves = np.empty(count, np.int32)
    chunk = 256
    for block in prange((count + chunk - 1) // chunk):
        stack, scratch = search_workspace()
        leaf = int(np.int64(0))  # of one type, or numba compiles the search twice
        for index in range(block * chunk, min(count, (block + 1) * chunk)):
            x, y, z = points[index, 0], points[index, 1], points[index, 2]
            leaf = nearest_face(x, y, z, leaf, squared_distance(corners[leaf], x, y, z), tree, stack, scratch)
            leaves[index] = leaf
    return leaves


@njit(cache=True, fastmath=True)
def nearest_face(
    x: float, y: float, z: float, leaf: int, squared: float, tree: Bvh, stack: np.ndarray, scratch: np.ndarray
) -> int:
    """Leaf of the nearest of the faces whose squared distance is below `squared`; `leaf` where there is none.

    Args:
        stack, scratch: of `search_workspace`.
    """
    blocks, boxes, levels = tree
    waiting, to_child = scratch[:_STACK_SIZE], scratch[_STACK_SIZE : _STACK_SIZE + LANES]
    to_face = scratch[_STACK_SIZE + LANES :]
    block_count = (levels[-1] + LANES - 1) // LANES
    best = np.float32(squared)
    stack[0], waiting[0] = levels[-2] - 1, np.float32(0.0)
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        if waiting[top] >= best:
            continue
        _to_children(node, boxes, x, y, z, to_child)
        if node < levels[1]:
            for child in range(min(LANES, block_count - node * LANES)):
                if to_child[child] < best:
                    block = node * LANES + child
                    _to_faces(block, blocks, x, y, z, to_face)
                    for lane in range(LANES):
                        if to_face[lane] < best:
                            best = to_face[lane]
                            leaf = block * LANES + lane
            continue
        base, end = _inner_children(node, levels)
        near, nearest = -1, best
        for child in range(end - base):
            if to_child[child] < best:
                stack[top], waiting[top] = base + child, to_child[child]
                if to_child[child] < nearest:
                    near, nearest = top, to_child[child]
                top += 1
        if near >= 0:  # the nearest child first
            stack[near], stack[top - 1] = stack[top - 1], stack[near]
            waiting[near], waiting[top - 1] = waiting[top - 1], waiting[near]
    return min(leaf, levels[-1] - 1)  # the last block may be padded


@njit(cache=True, inline="always")
def _inner_children(node: int, levels: np.ndarray) -> tuple[int, int]:
    """First child of a node above the lowest level, and the end of its children."""
    level = 1
    while node >= levels[level + 1]:
        level += 1
    base = levels[level - 1] + (node - levels[level]) * LANES
    return base, min(base + LANES, levels[level])


@njit(cache=True, fastmath=True, inline="always")
def _to_children(node: int, boxes: np.ndarray, x: float, y: float, z: float, squared: np.ndarray) -> None:
    """Fill in the squared distances to the boxes of a node's children, or to their slabs where these are farther."""
    box = boxes[node * (_BOX_ROWS * LANES) : (node + 1) * (_BOX_ROWS * LANES)]
    none = np.float32(0.0)
    for lane in range(LANES):
        dx = max(max(box[lane] - x, x - box[48 + lane]), none)
        dy = max(max(box[16 + lane] - y, y - box[64 + lane]), none)
        dz = max(max(box[32 + lane] - z, z - box[80 + lane]), none)
        height = x * box[96 + lane] + y * box[112 + lane] + z * box[128 + lane]
        beyond = max(max(box[144 + lane] - height, height - box[160 + lane]), none)
        squared[lane] = max(dx * dx + dy * dy + dz * dz, beyond * beyond)


@njit(cache=True, fastmath=True, inline="always")
def _to_faces(block: int, blocks: np.ndarray, x: float, y: float, z: float, squared: np.ndarray) -> None:
    """Fill in the squared distances to the faces of a block, without a branch.

    (u, v) is the point in the face's plane, its first edge from (0, 0) to (length, 0), its third corner at (cx, cy).
    """
    face = blocks[block * (_BLOCK_ROWS * LANES) : (block + 1) * (_BLOCK_ROWS * LANES)]
    for lane in range(LANES):
        px, py, pz = x - face[lane], y - face[16 + lane], z - face[32 + lane]
        height = px * face[48 + lane] + py * face[64 + lane] + pz * face[80 + lane]
        u = px * face[96 + lane] + py * face[112 + lane] + pz * face[128 + lane]
        v = px * face[144 + lane] + py * face[160 + lane] + pz * face[176 + lane]
        in_plane = squared_distance_in_plane(
            u, v, face[192 + lane], face[208 + lane], face[224 + lane], face[240 + lane], face[256 + lane]
        )
        squared[lane] = in_plane + height * height


def allocate_bvh(levels: Int[np.ndarray, " l"], batch: int) -> Bvh:
    """The tree of a batch of poses, for `refit_bvh` to fill."""
    blocks = -(-int(levels[-1]) // LANES)
    return Bvh(
        np.empty((batch, blocks * _BLOCK_ROWS * LANES), np.float32),
        np.empty((batch, int(levels[-2]) * _BOX_ROWS * LANES), np.float32),
        levels,
    )


@njit(cache=True)
def refit_bvh(corners: np.ndarray, tree: Bvh) -> None:
    """Fill the blocks and boxes of one pose from `corners` [k, 3, 3] in the leaf order."""
    blocks, boxes, levels = tree
    for leaf in range(len(blocks) // _BLOCK_ROWS):
        block, lane = leaf // LANES, leaf % LANES
        rows = blocks[block * (_BLOCK_ROWS * LANES) + lane : (block + 1) * (_BLOCK_ROWS * LANES) : LANES]
        face = corners[min(leaf, len(corners) - 1)]
        rows[0], rows[1], rows[2] = face[0]
        frame = face_frame(face)
        for row in range(3, _BLOCK_ROWS):
            rows[row] = frame[row - 3]
    for level in range(len(levels) - 2):
        for node in range(levels[level], levels[level + 1]):
            for lane in range(LANES):
                rows = boxes[node * (_BOX_ROWS * LANES) + lane : (node + 1) * (_BOX_ROWS * LANES) : LANES]
                if level == 0:
                    _enclose(corners[(node * LANES + lane) * LANES : (node * LANES + lane + 1) * LANES], rows)
                    continue
                child = levels[level - 1] + (node - levels[level]) * LANES + lane
                inner = boxes[child * (_BOX_ROWS * LANES) : (child + 1) * (_BOX_ROWS * LANES)]
                rows[:3], rows[3:6], rows[6:] = np.float32(_FAR), np.float32(-_FAR), np.float32(0.0)
                if child < levels[level]:
                    for axis in range(3):
                        rows[axis] = inner[axis * LANES : (axis + 1) * LANES].min()
                        rows[3 + axis] = inner[(3 + axis) * LANES : (4 + axis) * LANES].max()


@njit(cache=True, inline="always")
def _enclose(corners: np.ndarray, box: np.ndarray) -> None:
    """Write the box and the slab round some faces; of no faces they are inside out and far away."""
    for axis in range(3):
        low, high = np.float32(_FAR), np.float32(-_FAR)
        for face in range(len(corners)):
            for corner in range(3):
                low, high = min(low, corners[face, corner, axis]), max(high, corners[face, corner, axis])
        box[axis], box[3 + axis] = low, high
    nx, ny, nz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for face in range(len(corners)):
        a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
        ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = nx + uy * vz - uz * vy, ny + uz * vx - ux * vz, nz + ux * vy - uy * vx
    scale = np.float32(1.0) / max(np.sqrt(nx * nx + ny * ny + nz * nz), np.float32(1e-12))
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    low, high = np.float32(_FAR), np.float32(-_FAR)
    for face in range(len(corners)):
        for corner in range(3):
            height = corners[face, corner, 0] * nx + corners[face, corner, 1] * ny + corners[face, corner, 2] * nz
            low, high = min(low, height), max(high, height)
    box[6], box[7], box[8], box[9], box[10] = nx, ny, nz, low - np.float32(_ROUNDING), high + np.float32(_ROUNDING)
