"""Steps of the kernels of `quaffure.model.initial_shape_kernels` on one block: a strand in each lane of the vectors."""

from typing import Any

import numpy as np
from numba import njit

from quaffure.geometry.mls_kernels import (
    FAST,
    HEIGHT,
    LANES,
    MIN_LENGTH,
    NORMAL,
    POSITION,
    ROWS,
    WEIGHT,
    evaluate,
    list_points,
    normalize_features,
)
from quaffure.geometry.rotation_kernel import LEAST_ALIGNMENT, pushed_edge, rotated_by_gibbs
from quaffure.model import free_rod_lanes as rod
from quaffure.model.bfloat16 import rounded, stored

# How much farther than needed a block's list of skin points reaches, and how far ahead its centre is [radii].
_SLACK, _AHEAD = 0.1, 0.15

# Rows of a block after those of `evaluate`.
VERTEX = ROWS
DIRECTION = VERTEX + 3 * LANES
_LENGTH = DIRECTION + 3 * LANES
COMPLIANCE = _LENGTH + LANES
_FRAME = COMPLIANCE + LANES
_DEFLECTION = _FRAME + 9 * LANES  # of the last edge by the skin
_DISTURBANCE = _DEFLECTION + 3 * LANES  # largest rotation of an edge from the posed design, squared
_GIBBS = _DISTURBANCE + LANES  # rotation by the skin that the next edge takes over, tan(angle / 2) along the axis
_ROUNDED = _GIBBS + 3 * LANES  # as many as before `VERTEX`, rounded to bfloat16
ALL_ROWS = _ROUNDED + VERTEX


@njit(cache=True, fastmath=FAST, error_model="numpy")
def compute_roots(
    corners: np.ndarray, barycentric: np.ndarray, offset: np.ndarray, anchor: np.ndarray, tie: np.ndarray,
    scalp: np.ndarray, rows: np.ndarray,
) -> None:  # fmt: skip
    """Frames of the strands and first vertices: twin of `strand_frames` of `quaffure.model.initial_shape`."""
    for i in range(7 * LANES):
        rows[_DEFLECTION + i] = np.float32(0.0)
    for i in range(LANES):
        a, b, c = scalp[corners[0, i]], scalp[corners[1, i]], scalp[corners[2, i]]
        ax, ay, az = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        bx, by, bz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        along = np.float32(1.0) / np.sqrt(ax * ax + ay * ay + az * az)
        out = np.float32(1.0) / np.sqrt(nx * nx + ny * ny + nz * nz)
        ax, ay, az, nx, ny, nz = ax * along, ay * along, az * along, nx * out, ny * out, nz * out
        tx, ty, tz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
        u, v, w = barycentric[0, i], barycentric[1, i], barycentric[2, i]
        for axis in range(3):
            rows[VERTEX + axis * LANES + i] = u * a[axis] + v * b[axis] + w * c[axis]
        rows[_FRAME + i], rows[_FRAME + LANES + i], rows[_FRAME + 2 * LANES + i] = ax, tx, nx
        rows[_FRAME + 3 * LANES + i], rows[_FRAME + 4 * LANES + i], rows[_FRAME + 5 * LANES + i] = ay, ty, ny
        rows[_FRAME + 6 * LANES + i], rows[_FRAME + 7 * LANES + i], rows[_FRAME + 8 * LANES + i] = az, tz, nz
    for i in range(LANES):
        if anchor[i] >= 0:
            _point_to_tie(scalp[anchor[i]], tie, i, rows)
    for i in range(LANES):
        x, y, z = offset[0, i], offset[1, i], offset[2, i]
        for axis in range(3):
            row = _FRAME + 3 * axis * LANES + i
            rows[VERTEX + axis * LANES + i] += rows[row] * x + rows[row + LANES] * y + rows[row + 2 * LANES] * z


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _point_to_tie(anchor: np.ndarray, tie: np.ndarray, lane: int, rows: np.ndarray) -> None:
    """Frame of a tied strand: the smallest rotation that points it to its tie (`Ties.rotation`)."""
    one = np.float32(1.0)
    u = anchor[0] + tie[0, lane] - rows[VERTEX + lane]
    v = anchor[1] + tie[1, lane] - rows[VERTEX + LANES + lane]
    w = anchor[2] + tie[2, lane] - rows[VERTEX + 2 * LANES + lane]
    per_length = one / np.sqrt(u * u + v * v + w * w)
    u, v, w = u * per_length, v * per_length, w * per_length
    x, y, z = tie[3, lane], tie[4, lane], tie[5, lane]
    a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
    alignment = x * u + y * v + z * w
    scale = one / max(one + alignment, np.float32(1e-6))
    row = _FRAME + lane
    rows[row], rows[row + 4 * LANES], rows[row + 8 * LANES] = (
        alignment + scale * a * a,
        alignment + scale * b * b,
        alignment + scale * c * c,
    )
    rows[row + LANES], rows[row + 3 * LANES] = scale * a * b - c, scale * a * b + c
    rows[row + 2 * LANES], rows[row + 6 * LANES] = scale * a * c + b, scale * a * c - b
    rows[row + 5 * LANES], rows[row + 7 * LANES] = scale * b * c - a, scale * b * c + a


@njit(cache=True, fastmath=FAST, error_model="numpy")
def load(
    rest_edge: np.ndarray, loads: Any, joint: Any, pull: np.ndarray, stiffness: float, rows: np.ndarray,
    inputs: np.ndarray,
) -> None:  # fmt: skip
    """Fill an edge's input of `quaffure.model.free_rod_lanes.relax`.

    Args:
        loads, joint: moment, support and upness, and mass, bending and goal (`RodBlocks`).
        pull: acceleration [g].
    """
    one, none, tiny = np.float32(1.0), np.float32(0.0), np.float32(1e-24)
    (moment, support, upness), (mass, bending, goal) = loads, joint
    gx, gy, gz = pull[0], pull[1], pull[2]
    size = np.sqrt(gx * gx + gy * gy + gz * gz)
    per_size = one / max(size, np.float32(1e-12))
    for i in range(LANES):
        a, b, c = rows[_FRAME + i], rows[_FRAME + LANES + i], rows[_FRAME + 2 * LANES + i]
        d, e, f = rows[_FRAME + 3 * LANES + i], rows[_FRAME + 4 * LANES + i], rows[_FRAME + 5 * LANES + i]
        g, h, k = rows[_FRAME + 6 * LANES + i], rows[_FRAME + 7 * LANES + i], rows[_FRAME + 8 * LANES + i]
        x, y, z = rest_edge[0, i], rest_edge[1, i], rest_edge[2, i]
        length = np.sqrt(x * x + y * y + z * z)
        scale = one / max(length, np.float32(MIN_LENGTH))
        x, y, z = scale * x, scale * y, scale * z
        x, y, z = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + k * z
        inputs[rod.DIRECTION, i], inputs[rod.DIRECTION + 1, i], inputs[rod.DIRECTION + 2, i] = x, y, z
        inputs[rod.POSED, i], inputs[rod.POSED + 1, i], inputs[rod.POSED + 2, i] = x, y, z
        x, y, z = stiffness * moment[0, i], stiffness * moment[1, i], stiffness * moment[2, i]
        inputs[rod.MOMENT, i] = a * x + b * y + c * z
        inputs[rod.MOMENT + 1, i] = d * x + e * y + f * z
        inputs[rod.MOMENT + 2, i] = g * x + h * y + k * z
        x, y, z = support[0, i], support[1, i], support[2, i]
        x, y, z = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + k * z
        rising = -(gx * x + gy * y + gz * z) * per_size / np.sqrt(x * x + y * y + z * z + tiny)
        kept, own = size * min(max(one + rising, none) / upness[i], one), mass[i]
        inputs[rod.FORCE, i] = own * gx + kept * x
        inputs[rod.FORCE + 1, i] = own * gy + kept * y
        inputs[rod.FORCE + 2, i] = own * gz + kept * z
        inputs[rod.BENDING, i], inputs[rod.GOAL, i], inputs[rod.LENGTH, i] = stiffness * bending[i], goal[i], length


@njit(cache=True, fastmath=FAST, error_model="numpy")
def aim(inputs: np.ndarray, rows: np.ndarray) -> None:
    """Directions of the next edges, rotated like the edges before by the skin, and their lengths."""
    for i in range(LANES):
        rows[_LENGTH + i] = inputs[rod.LENGTH, i]
        free = inputs[rod.DIRECTION, i], inputs[rod.DIRECTION + 1, i], inputs[rod.DIRECTION + 2, i]
        gibbs = rows[_GIBBS + i], rows[_GIBBS + LANES + i], rows[_GIBBS + 2 * LANES + i]
        x, y, z = rotated_by_gibbs(gibbs, free)
        rows[DIRECTION + i], rows[DIRECTION + LANES + i], rows[DIRECTION + 2 * LANES + i] = x, y, z


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _step(radius: float, rows: np.ndarray) -> None:
    """Positions where the edges would end [radii]."""
    per_radius = np.float32(1.0) / radius
    for i in range(LANES):
        length = rows[_LENGTH + i]
        x, y, z = rows[DIRECTION + i], rows[DIRECTION + LANES + i], rows[DIRECTION + 2 * LANES + i]
        rows[POSITION + i] = (rows[VERTEX + i] + length * x) * per_radius
        rows[POSITION + LANES + i] = (rows[VERTEX + LANES + i] + length * y) * per_radius
        rows[POSITION + 2 * LANES + i] = (rows[VERTEX + 2 * LANES + i] + length * z) * per_radius


@njit(cache=True, fastmath=FAST, error_model="numpy")
def evaluate_ends(
    records: np.ndarray, positions: np.ndarray, radius: float, cover: np.ndarray, listed: int,
    inside: np.ndarray, near: np.ndarray, rows: np.ndarray,
) -> int:  # fmt: skip
    """Local features where the edges would end; lists points anew where one ends outside of `cover`, a centre and
    radius.

    Returns how many are listed.
    """
    _step(radius, rows)
    if _outside(cover, rows):
        _move_centre(cover, rows)
        cover[3] = _farthest(cover, rows) + np.float32(_SLACK)
        listed = list_points(cover, np.float32(1.0) + cover[3], positions, inside, near)
    evaluate(records, near, listed, rows)
    normalize_features(rows)
    return listed


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _outside(cover: np.ndarray, rows: np.ndarray) -> bool:
    """Whether any position is outside of a sphere, a centre and a radius; always if that is negative."""
    cx, cy, cz, square, outside = cover[0], cover[1], cover[2], cover[3] * cover[3], 0
    for i in range(LANES):
        x, y, z = rows[POSITION + i] - cx, rows[POSITION + LANES + i] - cy, rows[POSITION + 2 * LANES + i] - cz
        outside += x * x + y * y + z * z > square
    return outside > 0 or cover[3] < np.float32(0.0)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _farthest(centre: np.ndarray, rows: np.ndarray) -> float:
    """Distance of the farthest position."""
    cx, cy, cz, farthest = centre[0], centre[1], centre[2], np.float32(0.0)
    for i in range(LANES):
        x, y, z = rows[POSITION + i] - cx, rows[POSITION + LANES + i] - cy, rows[POSITION + 2 * LANES + i] - cz
        farthest = max(farthest, x * x + y * y + z * z)
    return np.sqrt(farthest)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _move_centre(centre: np.ndarray, rows: np.ndarray) -> None:
    """Move the centre amid the positions and a little on along the strand in the middle."""
    for axis in range(3):
        low, high = rows[POSITION + axis * LANES], rows[POSITION + axis * LANES]
        for i in range(1, LANES):
            low, high = min(low, rows[POSITION + axis * LANES + i]), max(high, rows[POSITION + axis * LANES + i])
        ahead = np.float32(_AHEAD) * rows[DIRECTION + axis * LANES + LANES // 2]
        centre[axis] = np.float32(0.5) * (low + high) + ahead


@njit(cache=True, fastmath=FAST, error_model="numpy")
def deflect(margin: np.ndarray, radius: float, decay_length: float, rows: np.ndarray) -> None:
    """Rotate edges out of the skin."""
    one, none = np.float32(1.0), np.float32(0.0)
    for i in range(LANES):
        normal = rows[NORMAL + i], rows[NORMAL + LANES + i], rows[NORMAL + 2 * LANES + i]
        ux, uy, uz = rows[DIRECTION + i], rows[DIRECTION + LANES + i], rows[DIRECTION + 2 * LANES + i]
        depth = max(margin[i] * rows[WEIGHT + i] - radius * rows[HEIGHT + i], none)
        angle = depth / max(rows[_LENGTH + i], np.float32(MIN_LENGTH))
        vx, vy, vz = pushed_edge((none, none, none), (ux, uy, uz), normal, angle, one)
        rows[DIRECTION + i], rows[DIRECTION + LANES + i], rows[DIRECTION + 2 * LANES + i] = vx, vy, vz
        share = decay_length / (decay_length + rows[_LENGTH + i])
        half = one / max(one + ux * vx + uy * vy + uz * vz, np.float32(LEAST_ALIGNMENT))
        rows[_GIBBS + i] = share * (rows[_GIBBS + i] + half * (uy * vz - uz * vy))
        rows[_GIBBS + LANES + i] = share * (rows[_GIBBS + LANES + i] + half * (uz * vx - ux * vz))
        rows[_GIBBS + 2 * LANES + i] = share * (rows[_GIBBS + 2 * LANES + i] + half * (ux * vy - uy * vx))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def comply(compliance: np.ndarray, inputs: np.ndarray, pull: np.ndarray, stiffness: float, rows: np.ndarray) -> None:
    """Compliance of joints under the loads of now, and how far the skin has bent them; one at most. Directions in
    `inputs` become those after contact, and what they were the free ones.

    Reads and writes the deflection of the last edge in the rows of `_DEFLECTION`, and the largest rotation of an edge
    from the posed design so far, squared, in those of `_DISTURBANCE`.
    """
    size = np.sqrt(pull[0] * pull[0] + pull[1] * pull[1] + pull[2] * pull[2]) / stiffness
    for i in range(LANES):
        tx, ty, tz = rows[DIRECTION + i], rows[DIRECTION + LANES + i], rows[DIRECTION + 2 * LANES + i]
        x, y, z = tx - inputs[rod.POSED, i], ty - inputs[rod.POSED + 1, i], tz - inputs[rod.POSED + 2, i]
        rows[_DISTURBANCE + i] = max(rows[_DISTURBANCE + i], x * x + y * y + z * z)
        a, b = tx - inputs[rod.DIRECTION, i], ty - inputs[rod.DIRECTION + 1, i]
        c = tz - inputs[rod.DIRECTION + 2, i]
        x, y = a - rows[_DEFLECTION + i], b - rows[_DEFLECTION + LANES + i]
        z = c - rows[_DEFLECTION + 2 * LANES + i]
        rows[_DEFLECTION + i], rows[_DEFLECTION + LANES + i], rows[_DEFLECTION + 2 * LANES + i] = a, b, c
        rows[COMPLIANCE + i] = min(size * compliance[i] + np.sqrt(x * x + y * y + z * z), np.float32(1.0))
        for axis in range(3):
            inputs[rod.FREE + axis, i] = inputs[rod.DIRECTION + axis, i]
        inputs[rod.DIRECTION, i], inputs[rod.DIRECTION + 1, i], inputs[rod.DIRECTION + 2, i] = tx, ty, tz


@njit(cache=True, fastmath=FAST, error_model="numpy")
def fade(
    row_of: np.ndarray, anchor: np.ndarray, least: float, tied_share: float, rows: np.ndarray, compliance: np.ndarray
) -> None:
    """Lower the compliance of strands that rest near their design, and of tied ones.

    Args:
        anchor: see `StrandBlocks`.
        least: squared rotation at which it is halved.
        tied_share: what is left of a tied strand's.
        compliance: of all rows.
    """
    for i in range(LANES):
        square = rows[_DISTURBANCE + i]
        if i == 0 or row_of[i] != row_of[i - 1]:  # the last strand may be repeated
            share = tied_share if anchor[i] >= 0 else np.float32(1.0)
            compliance[row_of[i]] *= share * square / (square + least)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def advance(rows: np.ndarray) -> None:
    for i in range(LANES):
        length = rows[_LENGTH + i]
        rows[VERTEX + i] += length * rows[DIRECTION + i]
        rows[VERTEX + LANES + i] += length * rows[DIRECTION + LANES + i]
        rows[VERTEX + 2 * LANES + i] += length * rows[DIRECTION + 2 * LANES + i]


@njit(cache=True)
def write_local_features(rows: np.ndarray, row_of: np.ndarray, edge: int, count: int, features: np.ndarray) -> None:
    """Write the local features of the ends of edges before contact."""
    bits, local, source = rows.view(np.uint32), 3 * count + 5 * edge, 0
    if features.itemsize == 2:
        source = _ROUNDED
        for i in range(VERTEX):
            bits[_ROUNDED + i] = rounded(bits[i])
    for i in range(LANES):
        row = row_of[i]
        for axis in range(3):
            features[row, local + 1 + axis] = bits[source + NORMAL + axis * LANES + i]
        features[row, local] = bits[source + HEIGHT + i]
        features[row, local + 4] = bits[source + WEIGHT + i]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def write_edges(
    inputs: np.ndarray, row_of: np.ndarray, roots: np.ndarray, rows: np.ndarray, edges: np.ndarray,
    features: np.ndarray,
) -> None:  # fmt: skip
    """Write the edges in `inputs`, and where they end as the first features."""
    bits = rows.view(np.uint32)
    for i in range(LANES):
        row = row_of[i]
        for axis in range(3):
            end = VERTEX + axis * LANES + i
            rows[end] = roots[row, axis]
            for edge in range(len(inputs)):
                direction = inputs[edge, rod.DIRECTION + axis, i]
                rows[end] += inputs[edge, rod.LENGTH, i] * direction
                edges[row, edge, axis] = direction
                features[row, 3 * edge + axis] = stored(bits[end], features.itemsize)
