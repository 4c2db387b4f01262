"""The closest point of a triangle and the signed distance that follows from it, one scalar function each.

Every nearest-face search and every contact kernel calls these. Their constants are float32 numbers that float64 holds
exactly too, so that the precision is that of the arguments. Numba inlines them into the calling loop.
"""

import numpy as np
from numba import njit

ON_SURFACE = 1e-7
"""Closer than this the offset from the surface has no direction [m]."""
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)  # a face without area divides by nothing else
_ON_SURFACE = np.float32(ON_SURFACE)


@njit(cache=True, fastmath=True)
def closest_on_triangle(triangle: np.ndarray, x: float, y: float, z: float) -> tuple[float, float, float, int]:
    """Closest point of a triangle, and its feature: 0 face, 1-3 the edge from corner 0-2, 4-6 corner 0-2.

    Ericson, Real-Time Collision Detection (2005), section 5.1.5, by Voronoi regions.
    """
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
        t = d2 / max(d2 - d6, _TINY)
        return ax + t * acx, ay + t * acy, az + t * acz, 3
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / max((d4 - d3) + (d5 - d6), _TINY)
        return ax + abx + t * (acx - abx), ay + aby + t * (acy - aby), az + abz + t * (acz - abz), 2
    scale = _ONE / max(va + vb + vc, _TINY)
    v, w = vb * scale, vc * scale
    return ax + v * abx + w * acx, ay + v * aby + w * acy, az + v * abz + w * acz, 0


@njit(cache=True, fastmath=True, inline="always")
def squared_distance(triangle: np.ndarray, x: float, y: float, z: float) -> float:
    """Squared distance of a point from a triangle [m^2]."""
    cx, cy, cz, _ = closest_on_triangle(triangle, x, y, z)
    return (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2


@njit(cache=True, fastmath=True, inline="always")
def squared_distance_in_plane(
    u: float, v: float, length: float, cx: float, cy: float, inverse_ac: float, inverse_bc: float
) -> float:
    """Squared distance of a point in a triangle's plane from the triangle, 0 inside, without a branch [m^2].

    Args:
        u, v: the point; the first corner is (0, 0), the second (`length`, 0), the third (`cx`, `cy`), `cy` >= 0.
        inverse_ac, inverse_bc: inverse squared lengths of the edges at the third corner.
    """
    du = u - min(max(u, _ZERO), length)
    squared = du * du + v * v
    share = min(max((u * cx + v * cy) * inverse_ac, _ZERO), _ONE)
    du, dv = u - share * cx, v - share * cy
    squared = min(squared, du * du + dv * dv)
    bx, bu = cx - length, u - length
    share = min(max((bu * bx + v * cy) * inverse_bc, _ZERO), _ONE)
    du, dv = bu - share * bx, v - share * cy
    squared = min(squared, du * du + dv * dv)
    inside = min(min(v, u * cy - v * cx), bx * v - cy * bu)
    return squared if inside < _ZERO else _ZERO


@njit(cache=True, fastmath=True, inline="always")
def signed_distance_from_offset(
    ox: float, oy: float, oz: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float, float]:
    """Signed distance of a point [m], positive outside, and its gradient, a unit vector.

    Args:
        ox, oy, oz: offset of the point from its closest point on the surface [m].
        nx, ny, nz: outward pseudonormal of the closest feature, of any length (Baerentzen and Aanaes 2005).
    """
    distance = np.sqrt(ox * ox + oy * oy + oz * oz)
    signed = -distance if ox * nx + oy * ny + oz * nz < _ZERO else distance
    if distance > _ON_SURFACE:
        scale = _ONE / signed
        return signed, ox * scale, oy * scale, oz * scale
    scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
    return signed, nx * scale, ny * scale, nz * scale
