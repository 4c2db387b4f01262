"""Signed distance to the body with its concave edges rounded, and its second derivatives, in double precision.

Where two faces of a hollow are equally near, the distance to the nearest of them has a kink, and contact holds hair in
just such places: there the energy has a minimum, but no gradient that vanishes. The smooth minimum
-w ln(sum exp(-d / w)) over the faces near by has one everywhere outside the body. It never exceeds the nearest
distance, so that Eq. 10 is never below its exact value; it is w ln 2 less at an edge, where two faces count, w ln 6 at
a corner of six, and nothing less in the middle of a face. Counting a foot once only, however many faces share it, would
be closer, but then the distance jumps where a foot passes a corner of a hollow, and line searches end there.
"""

import math

import numpy as np
from numba import njit

from quaffure.geometry.bvh import faces_within, nearest_face, search_workspace
from quaffure.geometry.occupancy_grid import FREE, FREE_DISTANCE, UNKNOWN, classify
from quaffure.geometry.surface import Surface, SurfaceArrays, bvh_of, occupancy_of
from quaffure.geometry.triangle import ON_SURFACE, closest_on_triangle, signed_distance_from_offset, squared_distance

ROUNDING_WIDTH = 2e-5
"""w, over which concave edges are rounded [m]."""
_BAND = 20 * ROUNDING_WIDTH  # a face this much farther weighs 2e-9
_FLOAT32_ERROR = 1e-6  # of distances in float32 [m]
_MAX_FEET = 256


def body_arrays(surface: Surface, sample: int) -> SurfaceArrays:
    """One sample of a surface, corners and normals in float64."""
    arrays = surface.sample_arrays(sample)
    return arrays._replace(corners=arrays.corners.astype(np.float64), normals=arrays.normals.astype(np.float64))


@njit(cache=True)
def rounded_distance(
    point: np.ndarray, leaf: int, margin: float, body: SurfaceArrays,
    normal: np.ndarray, rounding: np.ndarray, bending: np.ndarray,
) -> tuple[float, int]:  # fmt: skip
    """Signed distance of a point [m] and the leaf of its nearest face.

    Nothing is filled where the distance is not below `margin`; it may then be infinite.
    The Hessian of the distance is `bending` - `rounding`.

    Args:
        leaf: where to start the search for the nearest face.
        normal: filled with the gradient of the distance.
        rounding: filled with what rounding takes off the Hessian, positive semidefinite [1/m].
        bending: filled with the Hessian due to the body's edges and corners: positive semidefinite outside,
            negative inside [1/m].
    """
    near, leaf = _nearest_leaf(point, leaf, margin + _BAND, body)
    if not near:
        return np.inf, leaf
    x, y, z = point
    cx, cy, cz, feature = closest_on_triangle(body.corners[leaf], x, y, z)
    nx, ny, nz = body.normals[leaf, feature]
    signed, nx, ny, nz = signed_distance_from_offset(x - cx, y - cy, z - cz, nx, ny, nz)
    if signed >= margin + _BAND:
        return signed, leaf
    normal[:] = 0.0
    rounding[:] = 0.0
    bending[:] = 0.0
    nearest, inside = abs(signed), signed < 0.0
    if nearest <= ON_SURFACE:
        normal[0], normal[1], normal[2] = nx, ny, nz
        return signed, leaf
    if inside:
        _add_foot(point, leaf, -1.0, 1.0, body, normal, rounding, bending)
        return signed, leaf
    feet = np.empty(_MAX_FEET, np.int32)
    distances = np.empty(_MAX_FEET)
    found = _feet(point, nearest + _BAND, body, feet, distances)
    total = 0.0
    for foot in range(found):
        weight = math.exp((nearest - distances[foot]) / ROUNDING_WIDTH)
        total += weight
        _add_foot(point, feet[foot], 1.0, weight, body, normal, rounding, bending)
    normal /= total
    for row in range(3):
        for column in range(3):
            bending[row, column] /= total
            rounding[row, column] = (rounding[row, column] / total - normal[row] * normal[column]) / ROUNDING_WIDTH
    return signed - ROUNDING_WIDTH * math.log(total), leaf


@njit(cache=True)
def _nearest_leaf(point: np.ndarray, leaf: int, limit: float, body: SurfaceArrays) -> tuple[bool, int]:
    """Leaf of the nearest face, searched from `leaf` on; False where the point is known to be `limit` away."""
    x, y, z = point
    where = classify(x, y, z, occupancy_of(body))
    if where == FREE and limit <= FREE_DISTANCE:
        return False, leaf
    stack, scratch = search_workspace()
    if where == UNKNOWN:
        start = squared_distance(body.corners[leaf], x, y, z)
        return True, nearest_face(x, y, z, leaf, start, bvh_of(body), stack, scratch)
    found = nearest_face(x, y, z, -1, limit * limit, bvh_of(body), stack, scratch)
    return found >= 0, max(found, 0)


@njit(cache=True)
def _feet(point: np.ndarray, limit: float, body: SurfaceArrays, feet: np.ndarray, distances: np.ndarray) -> int:
    """List the faces nearer than `limit` and their distances; return their number."""
    x, y, z = point
    stack, scratch = search_workspace()
    candidates = faces_within(x, y, z, limit + _FLOAT32_ERROR, bvh_of(body), stack, scratch, feet)
    found = 0
    for index in range(candidates):
        distance = math.sqrt(squared_distance(body.corners[feet[index]], x, y, z))
        if distance < limit:
            feet[found], distances[found] = feet[index], distance
            found += 1
    return found


@njit(cache=True)
def _add_foot(
    point: np.ndarray, leaf: int, sign: float, weight: float, body: SurfaceArrays,
    normal: np.ndarray, square: np.ndarray, bending: np.ndarray,
) -> None:  # fmt: skip
    """Add a face's unit gradient n of the distance, n n^T, and the distance's Hessian, times `weight`."""
    triangle = body.corners[leaf]
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
                bending[row, column] += weight * sign * across / distance
