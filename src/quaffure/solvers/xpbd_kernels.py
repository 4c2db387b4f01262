"""The constraint projections of XPBD, eight strands abreast, and their density pass.

Strands are packed in blocks [vertex, axis, lane]: the sweep is sequential along a strand, so the compiler's vector
lanes run over strands, and a block stays in the nearest cache for all sweeps between two searches of the surroundings.
float64 there: with long time steps a root's tension moves its vertex by metres, of which micrometres are left.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.energies.fused_density import Particles
from quaffure.energies.smoothing_kernel import kernel_slope, kernel_value, per_kernel_volume
from quaffure.geometry.bvh import nearest_face, search_workspace
from quaffure.geometry.cell_list import cell_columns
from quaffure.geometry.occupancy_grid import FREE_DISTANCE, is_clear
from quaffure.geometry.surface import SurfaceArrays, bvh_of, occupancy_of
from quaffure.geometry.triangle import closest_on_triangle, signed_distance_from_offset, squared_distance

LANES = 8
"""Strands in a block: one 512-bit register of float64."""
FAR_AWAY = -1.0
"""Plane offset [m] of a vertex that touches nothing."""


class XpbdBlocks(NamedTuple):
    """Strands in blocks, the lane last, with the multipliers and constants of their constraints.

    Attributes:
        x: positions from each strand's root [m], [block vertex 3 lane].
        tension: T, total multiplier of each edge over m_ref [m], [block edge 3 lane].
        contact: displacement by the contact force [m], [block vertex 3 lane].
        plane: outward normal n and offset of the plane of every vertex, where n x = offset is the collision margin
            [m], [block vertex 4 lane].
        inverse_mass: w = m_ref / m, zero at the root, [block vertex lane].
        edge: W = w0 + w1; W k_s l; 1 / (1 + W (k_c / l^2 + k_s)), [block edge 3 lane].
        pull: W (k_c / l) d3 [m], [block edge 3 lane].
    """

    x: np.ndarray
    tension: np.ndarray
    contact: np.ndarray
    plane: np.ndarray
    inverse_mass: np.ndarray
    edge: np.ndarray
    pull: np.ndarray


class PlaneSearch(NamedTuple):
    """The last search for the nearest face of every vertex, [strand vertex].

    Attributes:
        position: of the vertex at that time [m].
        clearance: how far it may move from there before it can touch [m].
        leaf: its nearest face, from which every search starts.
    """

    position: np.ndarray
    clearance: np.ndarray
    leaf: np.ndarray


@njit(cache=True, parallel=True, fastmath=True)
def sweep_strands(
    strands: XpbdBlocks, contact_stiffness: float, relaxation: float, most_push: float, sweeps: int
) -> None:
    """Project the edges and contacts of all strands `sweeps` times, in turn from root to tip and back.

    Changes `x`, `tension` and `contact`.

    Args:
        contact_stiffness: 3 k_bc dt^2 / m_ref [1/m].
        relaxation: omega of successive over-relaxation of the edges.
        most_push: how far one projection of a contact moves a vertex at most [m].
    """
    for index in prange(len(strands.x)):
        block: Any = np.int64(index)  # one type, see `quaffure.energies.stability.stable_factors`
        _sweep_block(block, strands, contact_stiffness, relaxation, most_push, sweeps)


# Called, not written out in the parallel loop: numba may drop assignments to fields of a tuple there as dead code.
@njit(cache=True, fastmath=True)
def _sweep_block(
    block: int, strands: XpbdBlocks, contact_stiffness: float, relaxation: float, most_push: float, sweeps: int
) -> None:
    x, tension, contact = strands.x[block], strands.tension[block], strands.contact[block]
    plane, inverse_mass = strands.plane[block], strands.inverse_mass[block]
    edge, pull = strands.edge[block], strands.pull[block]
    edges = len(tension)
    for sweep in range(sweeps):
        for step in range(edges):
            index = step if sweep % 2 == 0 else edges - 1 - step
            _project_edge(x, tension, inverse_mass, edge, pull, relaxation, index)
            _project_contact(
                x[index + 1], contact[index + 1], plane[index + 1], inverse_mass[index + 1],
                contact_stiffness, most_push,
            )  # fmt: skip


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


@njit(cache=True, parallel=True)
def find_planes(
    positions: np.ndarray, roots: np.ndarray, margin: np.ndarray, surface: SurfaceArrays, last: PlaneSearch,
    plane: np.ndarray,
) -> None:  # fmt: skip
    """Renew the plane of every vertex [m, world, float32] that may have come within its margin.

    Args:
        surface: of one sample.
        last: changed.
        plane: as in `XpbdBlocks`; changed.
    """
    for index in prange(len(margin)):
        strand: Any = np.int64(index)  # one type, as above
        _find_planes_of_strand(strand, positions, roots, margin, surface, last, plane)


@njit(cache=True)
def _find_planes_of_strand(
    strand: int, positions: np.ndarray, roots: np.ndarray, margin: np.ndarray, surface: SurfaceArrays,
    last: PlaneSearch, plane: np.ndarray,
) -> None:  # fmt: skip
    tree, space = bvh_of(surface), occupancy_of(surface)
    stack, scratch = search_workspace()
    block, lane = strand // LANES, strand % LANES
    for vertex in range(1, margin.shape[1]):
        point = positions[strand, vertex]
        moved = math.sqrt(((point - last.position[strand, vertex]) ** 2).sum())
        if moved < last.clearance[strand, vertex]:
            continue
        out = plane[block, vertex, :, lane]
        out[:3], out[3] = 0.0, FAR_AWAY
        last.clearance[strand, vertex] = 0.0
        x, y, z = point[0], point[1], point[2]
        if margin[strand, vertex] <= np.float32(FREE_DISTANCE) and is_clear(x, y, z, space):
            continue
        leaf = last.leaf[strand, vertex]
        leaf = nearest_face(x, y, z, leaf, squared_distance(surface.corners[leaf], x, y, z), tree, stack, scratch)
        last.leaf[strand, vertex] = leaf
        cx, cy, cz, feature = closest_on_triangle(surface.corners[leaf], x, y, z)
        nx, ny, nz = surface.normals[leaf, feature]
        distance, out[0], out[1], out[2] = signed_distance_from_offset(x - cx, y - cy, z - cz, nx, ny, nz)
        last.position[strand, vertex] = point
        last.clearance[strand, vertex] = max(distance - margin[strand, vertex], 0.0)
        # Shortfall margin - (distance + n (x - point)), with x relative to the root.
        height = 0.0
        for axis in range(3):
            height += out[axis] * (float(point[axis]) - float(roots[strand, axis]))
        out[3] = margin[strand, vertex] - distance + height


@njit(cache=True, parallel=True, fastmath=True)
def excess_and_mobility(
    particles: Particles, inverse: np.ndarray, rest_density: np.ndarray, shape: tuple[int, int, int], h: np.float32,
    excess: np.ndarray, mobility: np.ndarray,
) -> None:  # fmt: skip
    """Density minus that at rest [kg/m^3], and how fast its own pressure lowers it: the sum over the vertices j near i
    of `inverse`_j times the squared gradient of density i with respect to x_j, all in the sorted order."""
    x, y, z, mass, start = particles
    scale = per_kernel_volume(h)
    per_metre = scale / h
    for cell in prange(len(start) - 1):
        if start[cell] == start[cell + 1]:
            continue
        ranges = np.empty((9, 2), np.int64)
        found = cell_columns(cell, shape, start, ranges)
        for row in range(start[cell], start[cell + 1]):
            px, py, pz = x[row], y[row], z[row]
            total, spread = np.float32(0.0), np.float32(0.0)
            gx, gy, gz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for column in range(found):
                near_by = slice(ranges[column, 0], ranges[column, 1])
                xs, ys, zs, masses, inverses = x[near_by], y[near_by], z[near_by], mass[near_by], inverse[near_by]
                for other in range(len(xs)):
                    dx, dy, dz = px - xs[other], py - ys[other], pz - zs[other]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    total += masses[other] * kernel_value(r / h)
                    slope = masses[other] * kernel_slope(r / h)
                    # W' has no direction at r = 0: the vertex itself.
                    slope = slope if r > np.float32(1e-8) else np.float32(0.0)
                    spread += inverses[other] * slope * slope
                    slope /= max(r, np.float32(1e-8))
                    gx += slope * dx
                    gy += slope * dy
                    gz += slope * dz
            excess[row] = total * scale - rest_density[row]
            mobility[row] = per_metre * per_metre * (spread + inverse[row] * (gx * gx + gy * gy + gz * gz))
