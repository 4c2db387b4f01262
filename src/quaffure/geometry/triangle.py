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


@njit(cache=True, inline="always")
def face_frame(face: np.ndarray) -> tuple[float, ...]:
    """What `squared_distance_in_plane` needs of a face [3, 3], and its directions.

    Returns:
        The unit normal, the directions along the first edge and across it, three numbers each; length of that edge,
        third corner in the plane (two), inverse squared lengths of the other two edges; twice the area. A sliver keeps
        a true frame, whatever its normal, and counts as without area.
    """
    bx, by, bz = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1], face[1, 2] - face[0, 2]
    cx, cy, cz = face[2, 0] - face[0, 0], face[2, 1] - face[0, 1], face[2, 2] - face[0, 2]
    length, other_length = np.sqrt(bx * bx + by * by + bz * bz), np.sqrt(cx * cx + cy * cy + cz * cz)
    tx, ty, tz, scale = bx, by, bz, _ONE / max(length, np.float32(1e-20))
    if length == 0.0:
        tx, ty, tz, scale = cx, cy, cz, _ONE / max(other_length, np.float32(1e-20))
    tx, ty, tz = tx * scale, ty * scale, tz * scale
    nx, ny, nz = ty * cz - tz * cy, tz * cx - tx * cz, tx * cy - ty * cx
    width = np.sqrt(nx * nx + ny * ny + nz * nz)
    area = length * width
    if width <= np.float32(1e-4) * other_length:  # the cross product is rounding: any perpendicular will do
        nx, ny, nz = (-ty, tx, _ZERO) if abs(tz) < np.float32(0.7) else (_ZERO, -tz, ty)
        width, area = max(np.sqrt(nx * nx + ny * ny + nz * nz), np.float32(1e-20)), _ZERO
    scale = _ONE / width
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    sx, sy, sz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    u, v = cx * tx + cy * ty + cz * tz, cx * sx + cy * sy + cz * sz
    inverse_ac = _ONE / max(u * u + v * v, np.float32(1e-24))
    inverse_bc = _ONE / max((u - length) * (u - length) + v * v, np.float32(1e-24))
    return nx, ny, nz, tx, ty, tz, sx, sy, sz, length, u, v, inverse_ac, inverse_bc, area


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
