"""Signed distance to the body with its creases rounded, and its second derivatives, in double precision.

Where two faces of a hollow are equally near, the distance to the nearest of them has a kink, and contact holds hair in
just such places: there the energy has a minimum, but no gradient that vanishes. The smooth minimum
-w ln(sum exp(-d / w)) over the faces near by has one everywhere outside the body. It never exceeds the nearest
distance, so that Eq. 10 is never below its exact value; it is w ln 2 less at an edge, where two faces count, w ln 6 at
a corner of six, and nothing less in the middle of a face. Counting a foot once only, however many faces share it, would
be closer, but then the distance jumps where a foot passes a corner of a hollow, and line searches end there.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quaffure.geometry.binary_bvh import (
    LANES,
    MAX_DEPTH,
    closest_on_triangle,
    squared_distance,
    squared_distance_to_box,
)
from quaffure.geometry.bvh import BVH_STACK, Bvh, nearest_face
from quaffure.geometry.occupancy_grid import FREE, OUTSIDE, OccupancyGrid, classify
from quaffure.geometry.surface import Surface

CREASE_WIDTH = 2e-5
"""w, over which creases are rounded [m]."""
_REACH = 20 * CREASE_WIDTH  # a face this much farther weighs 2e-9
_MAX_FEET = 256
_ON_SURFACE = 1e-7  # nearer than this the offset from the body has no direction [m]


class Body(NamedTuple):
    """One posed body's `Surface`; positions and normals in float64.

    Flat, for parallel kernels take no tuples within tuples: `Bvh` from `blocks` on, `OccupancyGrid` from `origin` on.
    """

    corners: np.ndarray
    normals: np.ndarray
    bounds: np.ndarray
    first: np.ndarray
    second: np.ndarray
    blocks: np.ndarray
    boxes: np.ndarray
    levels: np.ndarray
    origin: np.ndarray
    clear: np.ndarray
    slot: np.ndarray
    outside: np.ndarray
    free: np.ndarray


def body_arrays(surface: Surface, sample: int) -> Body:
    """One sample of a surface, as the kernels read it."""
    topology = surface.topology
    posed = (field[sample].astype(np.float64) for field in (surface.corners, surface.normals, surface.bounds))
    corners, normals, bounds = posed
    tree = (topology.tree.first, topology.tree.second)
    return Body(corners, normals, bounds, *tree, *surface.bvh(sample), *(field[sample] for field in surface.map))


@njit(cache=True)
def rounded_distance(
    point: np.ndarray, place: int, margin: float, body: Body, normal: np.ndarray, crease: np.ndarray, bulge: np.ndarray
) -> tuple[float, int]:
    """Signed distance of a point [m] and the place of its nearest face.

    Nothing is filled where the distance is not below `margin`; it may then be infinite.
    The Hessian of the distance is `bulge` - `crease`.

    Args:
        place: where to start the search for the nearest face.
        normal: filled with the gradient of the distance.
        crease: filled with what rounding takes off the Hessian, positive semidefinite [1/m].
        bulge: filled with the Hessian due to the body's edges and corners: positive semidefinite outside,
            negative inside [1/m].
    """
    near, place = _nearest_place(point, place, margin + _REACH, body)
    if not near:
        return np.inf, place
    cx, cy, cz, feature = closest_on_triangle(body.corners[place], point[0], point[1], point[2])
    ox, oy, oz = point[0] - cx, point[1] - cy, point[2] - cz
    pseudonormal = body.normals[place, feature]
    nearest = math.sqrt(ox * ox + oy * oy + oz * oz)
    inside = ox * pseudonormal[0] + oy * pseudonormal[1] + oz * pseudonormal[2] < 0.0
    signed = -nearest if inside else nearest
    if signed >= margin + _REACH:
        return signed, place
    normal[:] = 0.0
    crease[:] = 0.0
    bulge[:] = 0.0
    if nearest <= _ON_SURFACE:
        normal[:] = pseudonormal / math.sqrt((pseudonormal * pseudonormal).sum())
        return signed, place
    if inside:
        _add_foot(point, place, -1.0, 1.0, body, normal, crease, bulge)
        return signed, place
    feet = np.empty(_MAX_FEET, np.int32)
    distances = np.empty(_MAX_FEET)
    found = _feet(point, nearest + _REACH, body, feet, distances)
    total = 0.0
    for foot in range(found):
        weight = math.exp((nearest - distances[foot]) / CREASE_WIDTH)
        total += weight
        _add_foot(point, feet[foot], 1.0, weight, body, normal, crease, bulge)
    normal /= total
    for row in range(3):
        for column in range(3):
            bulge[row, column] /= total
            crease[row, column] = (crease[row, column] / total - normal[row] * normal[column]) / CREASE_WIDTH
    return signed - CREASE_WIDTH * math.log(total), place


@njit(cache=True)
def _nearest_place(point: np.ndarray, place: int, limit: float, body: Body) -> tuple[bool, int]:
    """Place of the nearest face, searched from `place` on; False where the point is known to be `limit` away."""
    x, y, z = point[0], point[1], point[2]
    where = classify(x, y, z, OccupancyGrid(body.origin, body.clear, body.slot, body.outside, body.free))
    if where == FREE:
        return False, place
    tree = Bvh(body.blocks, body.boxes, body.levels)
    waiting, room = np.empty(BVH_STACK, np.int32), np.empty(BVH_STACK + 2 * LANES, np.float32)
    if where == OUTSIDE:
        found = nearest_face(x, y, z, -1, limit * limit, tree, waiting, room)
        return found >= 0, max(found, 0)
    start = squared_distance(body.corners[place], x, y, z)
    return True, nearest_face(x, y, z, place, start, tree, waiting, room)


@njit(cache=True)
def _feet(point: np.ndarray, limit: float, body: Body, feet: np.ndarray, distances: np.ndarray) -> int:
    """List the faces nearer than `limit` and their distances; return their number."""
    stack = np.empty(MAX_DEPTH, np.int32)
    x, y, z = point[0], point[1], point[2]
    stack[0] = 0
    top, found = 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if squared_distance_to_box(body.bounds[node], x, y, z) >= limit * limit:
            continue
        if body.second[node] >= 0:
            stack[top], stack[top + 1] = body.first[node], body.second[node]
            top += 2
            continue
        for place in range(body.first[node], body.first[node] - body.second[node]):
            cx, cy, cz, _ = closest_on_triangle(body.corners[place], x, y, z)
            distance = math.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)
            if distance < limit and found < _MAX_FEET:
                feet[found], distances[found] = place, distance
                found += 1
    return found


@njit(cache=True)
def _add_foot(
    point: np.ndarray, place: int, sign: float, weight: float, body: Body,
    normal: np.ndarray, square: np.ndarray, bulge: np.ndarray,
) -> None:  # fmt: skip
    """Add a face's unit gradient n of the distance, n n^T, and the distance's Hessian, times `weight`."""
    triangle = body.corners[place]
    cx, cy, cz, feature = closest_on_triangle(triangle, point[0], point[1], point[2])
    away, along = np.empty(3), np.zeros(3)
    away[0], away[1], away[2] = point[0] - cx, point[1] - cy, point[2] - cz
    distance = math.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
    away *= sign / distance
    if 0 < feature <= 3:
        along[:] = triangle[feature % 3] - triangle[feature - 1]
        along /= math.sqrt((along * along).sum())
    for row in range(3):
        normal[row] += weight * away[row]
        for column in range(3):
            square[row, column] += weight * away[row] * away[column] if sign > 0.0 else 0.0
            if feature > 0:
                across = (1.0 if row == column else 0.0) - away[row] * away[column] - along[row] * along[column]
                bulge[row, column] += weight * sign * across / distance
