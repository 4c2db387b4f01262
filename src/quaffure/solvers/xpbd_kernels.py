"""The constraint projections of XPBD, eight strands abreast, and their density pass.

Strands are packed in blocks [vertex, axis, lane]: the sweep is sequential along a strand, so the compiler's vector
lanes run over strands, and a block stays in the nearest cache for all sweeps between two looks at the surroundings.
float64 there: with long time steps a root's tension moves its vertex by metres, of which micrometres are left.
Shapes cannot be checked at run time inside compiled code, hence `no_type_check`.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit, prange

from quaffure.energies.fused_density import Particles
from quaffure.geometry.binary_bvh import MAX_DEPTH, closest_on_triangle, search
from quaffure.geometry.cell_list import cell_columns
from quaffure.geometry.occupancy_grid import is_clear

LANES = 8
"""Strands in a block: one 512-bit register of float64."""
FAR_AWAY = -1.0
"""Plane offset [m] of a vertex that touches nothing."""


@no_type_check
@njit(cache=True, parallel=True, fastmath=True)
def sweep_strands(
    x: np.ndarray, tension: np.ndarray, contact: np.ndarray, plane: np.ndarray, inverse_mass: np.ndarray,
    edge: np.ndarray, pull: np.ndarray, contact_stiffness: float, relaxation: float, most_push: float, sweeps: int,
) -> None:  # fmt: skip
    """Project the edges and contacts of all strands `sweeps` times, in turn from root to tip and back.

    Args:
        x: positions from each strand's root [m], [block vertex 3 lane]; changed.
        tension: T, total multiplier of each edge over m_ref [m], [block edge 3 lane]; changed.
        contact: displacement by the contact force [m], [block vertex 3 lane]; changed.
        plane: outward normal n and offset of the plane of every vertex, where n x = offset is the collision margin
            [m], [block vertex 4 lane].
        inverse_mass: w = m_ref / m, zero at the root, [block vertex lane].
        edge: W = w0 + w1; W k_s l; 1 / (1 + W (k_c / l^2 + k_s)), [block edge 3 lane].
        pull: W (k_c / l) d3 [m], [block edge 3 lane].
        contact_stiffness: 3 k_bc dt^2 / m_ref [1/m].
        relaxation: omega of successive over-relaxation of the edges.
        most_push: how far one projection of a contact moves a vertex at most [m].
    """
    edges = tension.shape[1]
    for block in prange(len(x)):
        for sweep in range(sweeps):
            for place in range(edges):
                index = place if sweep % 2 == 0 else edges - 1 - place
                _project_edge(
                    x[block], tension[block], inverse_mass[block], edge[block], pull[block], relaxation, index
                )
                _project_contact(
                    x[block, index + 1], contact[block, index + 1], plane[block, index + 1],
                    inverse_mass[block, index + 1], contact_stiffness, most_push,
                )  # fmt: skip


@no_type_check
@njit(cache=True, fastmath=True, inline="always")
def _project_edge(
    x: np.ndarray, tension: np.ndarray, inverse_mass: np.ndarray, edge: np.ndarray, pull: np.ndarray,
    relaxation: float, index: int,
) -> None:  # fmt: skip
    near, far, force = x[index], x[index + 1], tension[index]
    w_near, w_far = inverse_mass[index], inverse_mass[index + 1]
    total, stiff, scale, bend = edge[index, 0], edge[index, 1], edge[index, 2], pull[index]
    for lane in range(LANES):
        tx, ty, tz = force[0, lane], force[1, lane], force[2, lane]
        w = total[lane]
        # e' = e + W T is the edge without its own force; p lies along the edge that Eqs. 6 and 7 make of it.
        ex = far[0, lane] - near[0, lane] + w * tx
        ey = far[1, lane] - near[1, lane] + w * ty
        ez = far[2, lane] - near[2, lane] + w * tz
        px, py, pz = ex + bend[0, lane], ey + bend[1, lane], ez + bend[2, lane]
        norm = np.sqrt(px * px + py * py + pz * pz) + 1e-30
        along = (norm + stiff[lane]) * scale[lane] / norm
        inverse = 1.0 / w
        dx = relaxation * ((ex - along * px) * inverse - tx)
        dy = relaxation * ((ey - along * py) * inverse - ty)
        dz = relaxation * ((ez - along * pz) * inverse - tz)
        force[0, lane] = tx + dx
        force[1, lane] = ty + dy
        force[2, lane] = tz + dz
        near[0, lane] += w_near[lane] * dx
        near[1, lane] += w_near[lane] * dy
        near[2, lane] += w_near[lane] * dz
        far[0, lane] -= w_far[lane] * dx
        far[1, lane] -= w_far[lane] * dy
        far[2, lane] -= w_far[lane] * dz


@no_type_check
@njit(cache=True, fastmath=True, inline="always")
def _project_contact(
    x: np.ndarray, contact: np.ndarray, plane: np.ndarray, inverse_mass: np.ndarray, stiffness: float, most_push: float
) -> None:
    for lane in range(LANES):
        nx, ny, nz = plane[0, lane], plane[1, lane], plane[2, lane]
        cx, cy, cz = contact[0, lane], contact[1, lane], contact[2, lane]
        fx, fy, fz = x[0, lane] - cx, x[1, lane] - cy, x[2, lane] - cz
        short = max(plane[3, lane] - (nx * fx + ny * fy + nz * fz), 0.0)
        # a s^2 + s = s' for the shortfall s under the force and s' without it.
        a = stiffness * inverse_mass[lane]
        left = 2.0 * short / (1.0 + np.sqrt(1.0 + 4.0 * a * short))
        push = min(short - left, most_push + max(nx * cx + ny * cy + nz * cz, 0.0))
        contact[0, lane], contact[1, lane], contact[2, lane] = push * nx, push * ny, push * nz
        x[0, lane] = fx + push * nx
        x[1, lane] = fy + push * ny
        x[2, lane] = fz + push * nz


@no_type_check
@njit(cache=True, parallel=True)
def find_planes(
    positions: np.ndarray, roots: np.ndarray, margin: np.ndarray, corners: np.ndarray, normals: np.ndarray,
    bounds: np.ndarray, first: np.ndarray, second: np.ndarray, clear_origin: np.ndarray, clear: np.ndarray,
    searched: np.ndarray, free: np.ndarray, places: np.ndarray, plane: np.ndarray,
) -> None:  # fmt: skip
    """Renew the plane of every vertex [m, world, float32] that may have come within its margin.

    Args:
        searched: where each vertex was when its nearest face was last sought [m]; changed.
        free: how far it may move from there before it can touch [m]; changed.
        places: its nearest face, where every search begins; changed.
        plane: as in `sweep_strands`; changed.
    """
    strands, vertices = margin.shape
    for strand in prange(strands):
        stack = np.empty(MAX_DEPTH, np.int32)
        block, lane = strand // LANES, strand % LANES
        for vertex in range(1, vertices):
            point = positions[strand, vertex]
            moved = math.sqrt(((point - searched[strand, vertex]) ** 2).sum())
            if moved < free[strand, vertex]:
                continue
            out = plane[block, vertex, :, lane]
            out[:3], out[3] = 0.0, FAR_AWAY
            free[strand, vertex] = 0.0
            if is_clear(point[0], point[1], point[2], clear_origin, clear):
                continue
            place = search(point, places[strand, vertex], corners, bounds, first, second, stack)
            places[strand, vertex] = place
            cx, cy, cz, feature = closest_on_triangle(corners[place], point[0], point[1], point[2])
            _tangent_plane(point, cx, cy, cz, normals[place, feature], out)
            distance = out[3]
            searched[strand, vertex] = point
            free[strand, vertex] = max(distance - margin[strand, vertex], 0.0)
            # Shortfall margin - (distance + n (x - point)), with x seen from the root.
            height = 0.0
            for axis in range(3):
                height += out[axis] * (float(point[axis]) - float(roots[strand, axis]))
            out[3] = margin[strand, vertex] - distance + height


@no_type_check
@njit(cache=True)
def _tangent_plane(point: np.ndarray, cx: float, cy: float, cz: float, normal: np.ndarray, out: np.ndarray) -> None:
    """Write the gradient of the signed distance at a point, and the signed distance [m], from its closest point."""
    ox, oy, oz = point[0] - cx, point[1] - cy, point[2] - cz
    distance = math.sqrt(ox * ox + oy * oy + oz * oz)
    out[3] = -distance if ox * normal[0] + oy * normal[1] + oz * normal[2] < 0.0 else distance
    if distance > 1e-7:
        out[0], out[1], out[2] = ox / out[3], oy / out[3], oz / out[3]
    else:
        out[:3] = normal / math.sqrt((normal.astype(np.float64) ** 2).sum())


@no_type_check
@njit(cache=True, parallel=True, fastmath=True)
def excess_and_mobility(
    particles: Particles, inverse: np.ndarray, rest_density: np.ndarray, shape: tuple[int, int, int], h: np.float32,
    excess: np.ndarray, mobility: np.ndarray,
) -> None:  # fmt: skip
    """Density minus that at rest [kg/m^3], and how fast its own pressure lowers it: the sum over the vertices j near i
    of `inverse`_j times the squared gradient of density i with respect to x_j, all in the sorted order."""
    x, y, z, mass, start = particles
    scale = np.float32(1.0 / (4.0 * math.pi)) / (h * h * h)
    slope = np.float32(3.0) * scale / h
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for place in range(start[cell], start[cell + 1]):
            px, py, pz = x[place], y[place], z[place]
            total, spread = np.float32(0.0), np.float32(0.0)
            gx, gy, gz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses, inverses = x[near_by], y[near_by], z[near_by], mass[near_by], inverse[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    q = r / h
                    far, near = max(np.float32(2.0) - q, np.float32(0.0)), max(np.float32(1.0) - q, np.float32(0.0))
                    total += masses[other] * (far * far * far - np.float32(4.0) * near * near * near)
                    # Eq. 13 falls by this much per h.
                    falls = masses[other] * (np.float32(4.0) * near * near - far * far)
                    # W' has no direction at r = 0: the vertex itself.
                    falls = falls if r > np.float32(1e-8) else np.float32(0.0)
                    spread += inverses[other] * falls * falls
                    falls /= max(r, np.float32(1e-8))
                    gx += falls * dx
                    gy += falls * dy
                    gz += falls * dz
            excess[place] = total * scale - rest_density[place]
            mobility[place] = slope * slope * (spread + inverse[place] * (gx * gx + gy * gy + gz * gz))
