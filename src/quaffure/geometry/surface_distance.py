"""Exact distance from a point to a posed surface inside compiled loops: the nearest face where it matters."""

from typing import Any

import numpy as np
from numba import njit

from quaffure.geometry.bvh import nearest_face
from quaffure.geometry.occupancy_grid import FREE, FREE_DISTANCE, UNKNOWN, classify
from quaffure.geometry.surface import SurfaceArrays, bvh_of, occupancy_of
from quaffure.geometry.triangle import closest_on_triangle, signed_distance_from_offset, squared_distance

_FREE_DISTANCE = np.float32(FREE_DISTANCE)
_FAR, _ZERO = np.float32(1e6), np.float32(0.0)


@njit(cache=True, fastmath=True, inline="always")
def distance_within(
    px: float, py: float, pz: float, margin: float, leaf: int, body: SurfaceArrays,
    workspace: tuple[np.ndarray, np.ndarray],
) -> tuple[Any, Any, Any, Any, int]:  # fmt: skip
    """Signed distance of a point to one posed surface [m], the unit vector along which it grows, and the nearest face.

    Where the point is outside and beyond the margin no face is searched: the distance is far, the vector 0, the face
    -1. An occupancy grid tells where a point is free of the body, or at least outside, where only faces within its
    margin are searched; where neither is known, the search is bounded by the distance to the face `leaf`.

    Args:
        px, py, pz: the point [m].
        margin: [m].
        leaf: some face, best one near the point.
        workspace: of `search_workspace`.
    """
    tree, space = bvh_of(body), occupancy_of(body)
    stack, scratch = workspace
    where = classify(px, py, pz, space)
    # One call of the search: its code is long, and would be compiled into every kernel twice.
    first: int = int(np.int64(-1))
    squared: Any = _ZERO
    if where == UNKNOWN:
        first, squared = leaf, squared_distance(body.corners[leaf], px, py, pz)
    elif margin > _FREE_DISTANCE or (where != FREE and margin > _ZERO):
        squared = margin * margin
    found = first
    if first >= 0 or squared > _ZERO:
        found = nearest_face(px, py, pz, first, squared, tree, stack, scratch)
    if found < 0:
        return _FAR, _ZERO, _ZERO, _ZERO, -1
    cx, cy, cz, feature = closest_on_triangle(body.corners[found], px, py, pz)
    nx, ny, nz = body.normals[found, feature]
    distance, nx, ny, nz = signed_distance_from_offset(px - cx, py - cy, pz - cz, nx, ny, nz)
    return distance, nx, ny, nz, found
