"""Bounding-box tree over the faces of a mesh: built once for a topology, refitted to every pose.

Nodes are stored parents first, so one backward sweep refits them. The compiled functions work on one posed mesh, in any
precision. Their torch twin is `quaffure.geometry.signed_distance.closest_points_reference`. Where only nearest faces
are wanted, in single precision, `quaffure.geometry.bvh` over the same order of faces is several times as fast.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit

LEAF_SIZE = 4
MAX_DEPTH = 64
LANES = 16
"""Children of a node and faces of a block in the wide tree."""


@dataclass(frozen=True)
class BinaryBvh:
    """Topology of the tree.

    Attributes:
        face_order: the face at each place of the leaves' order.
        first: of a leaf, its first place in `face_order`; of an inner node, its left child. The right child is
            `second`.
        second: of a leaf, minus its number of faces; of an inner node, its right child.
        levels: of the wide tree, the first node of every level from the lowest up, then the number of nodes, then
            that of faces. The children of the lowest level are blocks of `LANES` places of `face_order`.
    """

    face_order: Int[np.ndarray, " k"]
    first: Int[np.ndarray, " m"]
    second: Int[np.ndarray, " m"]
    levels: Int[np.ndarray, " l"]


def build_binary_bvh(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "k 3"]) -> BinaryBvh:
    """Trees by splits of the face centroids along the widest axis, in halves of whole blocks."""
    centroids = vertices[faces].mean(axis=1)
    order = np.arange(len(faces), dtype=np.int32)
    first: list[int] = []
    second: list[int] = []
    pending = [(0, len(faces), -1, False)]
    while pending:
        start, stop, parent, is_right = pending.pop()
        node = len(first)
        if parent >= 0:
            (second if is_right else first)[parent] = node
        if stop - start <= LEAF_SIZE:
            first.append(start)
            second.append(start - stop)
            continue
        first.append(0)
        second.append(0)
        spread = centroids[order[start:stop]]
        axis = int(np.argmax(spread.max(axis=0) - spread.min(axis=0)))
        middle = start + _left_share(stop - start)
        order[start:stop] = order[start:stop][np.argpartition(spread[:, axis], middle - start)]
        pending.append((middle, stop, node, True))
        pending.append((start, middle, node, False))
    return BinaryBvh(order, np.array(first, np.int32), np.array(second, np.int32), _wide_levels(len(faces)))


def _left_share(count: int) -> int:
    """How many of `count` faces go left: half, in the largest power of `LANES` that splits them.

    Every block, and every node of the wide tree, then is a node of the binary one: a compact piece of the surface.
    """
    if count <= LANES:
        return count // 2
    unit = LANES
    while unit * LANES < count:
        unit *= LANES
    return unit * max(1, -(-count // unit) // 2)


def _wide_levels(face_count: int) -> Int[np.ndarray, " l"]:
    children = -(-face_count // LANES)
    starts = [0]
    while len(starts) == 1 or children > 1:
        children = -(-children // LANES)
        starts.append(starts[-1] + children)
    return np.array([*starts, face_count], np.int64)


@njit(cache=True)  # no fastmath: it may take infinities for granted not to be there
def refit(corners: np.ndarray, first: np.ndarray, second: np.ndarray, bounds: np.ndarray) -> None:
    """Fill `bounds` [m, 6] (lower, then upper corner) from `corners` [k, 3, 3] in the leaves' order."""
    for node in range(len(first) - 1, -1, -1):
        box = bounds[node]
        if second[node] < 0:
            box[:3] = np.inf
            box[3:] = -np.inf
            for place in range(first[node], first[node] - second[node]):
                for corner in range(3):
                    for axis in range(3):
                        value = corners[place, corner, axis]
                        box[axis] = min(box[axis], value)
                        box[3 + axis] = max(box[3 + axis], value)
        else:
            left, right = bounds[first[node]], bounds[second[node]]
            for axis in range(3):
                box[axis] = min(left[axis], right[axis])
                box[3 + axis] = max(left[3 + axis], right[3 + axis])


@njit(cache=True, fastmath=True, inline="always")
def squared_distance_to_box(box: np.ndarray, x: float, y: float, z: float) -> float:
    dx = max(box[0] - x, x - box[3], np.float32(0.0))
    dy = max(box[1] - y, y - box[4], np.float32(0.0))
    dz = max(box[2] - z, z - box[5], np.float32(0.0))
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, fastmath=True)
def closest_on_triangle(triangle: np.ndarray, x: float, y: float, z: float) -> tuple[float, float, float, int]:
    """Closest point of a triangle, and its feature: 0 face, 1-3 the edge from corner 0-2, 4-6 corner 0-2.

    Ericson, Real-Time Collision Detection (2005), section 5.1.5, by Voronoi regions.
    """
    none = np.float32(1e-30)  # a face without area divides by nothing else
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    abx, aby, abz = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    acx, acy, acz = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    apx, apy, apz = x - ax, y - ay, z - az
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az, 4
    bpx, bpy, bpz = apx - abx, apy - aby, apz - abz
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return ax + abx, ay + aby, az + abz, 5
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:  # d1 - d3 is the squared edge: none, where corners coincide
        t = d1 / (d1 - d3)
        return ax + t * abx, ay + t * aby, az + t * abz, 1
    cpx, cpy, cpz = apx - acx, apy - acy, apz - acz
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return ax + acx, ay + acy, az + acz, 6
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / max(d2 - d6, none)
        return ax + t * acx, ay + t * acy, az + t * acz, 3
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / max((d4 - d3) + (d5 - d6), none)
        return ax + abx + t * (acx - abx), ay + aby + t * (acy - aby), az + abz + t * (acz - abz), 2
    scale = np.float32(1.0) / max(va + vb + vc, none)
    v, w = vb * scale, vc * scale
    return ax + v * abx + w * acx, ay + v * aby + w * acy, az + v * abz + w * acz, 0


@njit(cache=True, fastmath=True, inline="always")
def squared_distance(triangle: np.ndarray, x: float, y: float, z: float) -> float:
    cx, cy, cz, _ = closest_on_triangle(triangle, x, y, z)
    return (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2


@njit(cache=True, fastmath=True)
def search(
    point: np.ndarray,
    start: int,
    corners: np.ndarray,
    bounds: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    stack: np.ndarray,
) -> int:
    """Place (in the leaves' order) of the face nearest to `point`.

    Args:
        start: any place, the nearer the better: its distance bounds the search from the beginning.
        stack: room for `MAX_DEPTH` nodes, int32.
    """
    x, y, z = point[0], point[1], point[2]
    cx, cy, cz, _ = closest_on_triangle(corners[start], x, y, z)
    best = (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2
    place = start
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        if squared_distance_to_box(bounds[node], x, y, z) >= best:
            continue
        if second[node] < 0:
            for candidate in range(first[node], first[node] - second[node]):
                cx, cy, cz, _ = closest_on_triangle(corners[candidate], x, y, z)
                squared = (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2
                if squared < best:
                    best = squared
                    place = candidate
            continue
        left, right = first[node], second[node]
        to_left = squared_distance_to_box(bounds[left], x, y, z)
        to_right = squared_distance_to_box(bounds[right], x, y, z)
        near, far, to_near, to_far = left, right, to_left, to_right
        if to_right < to_left:
            near, far, to_near, to_far = right, left, to_right, to_left
        if to_far < best:
            stack[top] = far
            top += 1
        if to_near < best:
            stack[top] = near
            top += 1
    return place
