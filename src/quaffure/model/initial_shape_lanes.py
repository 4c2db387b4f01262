"""Steps of the kernels of `quaffure.model.initial_shape_kernels` on one block: a strand in each lane of the vectors."""

import numpy as np
from numba import njit

from quaffure.geometry.mls_surface import (
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

# How much farther than needed a block's list of skin points reaches, and how far ahead its centre is [radii].
_SLACK, _AHEAD = 0.1, 0.15

# Rows of a block after those of `evaluate`.
VERTEX = ROWS
DIRECTION = VERTEX + 3 * LANES
_LENGTH = DIRECTION + 3 * LANES
_BEYOND = _LENGTH + LANES
_WHOLE = _BEYOND + LANES
_FREE = _WHOLE + LANES  # directions in gravity's equilibrium, without contact
COMPLIANCE = _FREE + 3 * LANES
_STRENGTH = COMPLIANCE + LANES
_FRAME = _STRENGTH + LANES
_ROUNDED = _FRAME + 9 * LANES  # as many as before `DIRECTION`, rounded to bfloat16
ALL_ROWS = _ROUNDED + DIRECTION
# Rows of an edge's contact: the skin's normal, and how hard the skin holds its end alone, over k_Cosserat [1/m].
_OUT, _HELD, CONTACT_SIZE = 0, 3 * LANES, 4 * LANES


@njit(cache=True, fastmath=FAST, error_model="numpy")
def compute_roots(
    corners: np.ndarray, barycentric: np.ndarray, offset: np.ndarray, scalp: np.ndarray, rows: np.ndarray
) -> None:
    """Frames of the scalp triangles (`triangle_frames`) and first vertices."""
    for i in range(LANES):
        a, b, c = scalp[corners[0, i]], scalp[corners[1, i]], scalp[corners[2, i]]
        ax, ay, az = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        bx, by, bz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        along = np.float32(1.0) / np.sqrt(ax * ax + ay * ay + az * az)
        out = np.float32(1.0) / np.sqrt(nx * nx + ny * ny + nz * nz)
        ax, ay, az, nx, ny, nz = ax * along, ay * along, az * along, nx * out, ny * out, nz * out
        tx, ty, tz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
        ox, oy, oz = offset[0, i], offset[1, i], offset[2, i]
        u, v, w = barycentric[0, i], barycentric[1, i], barycentric[2, i]
        rows[VERTEX + i] = u * a[0] + v * b[0] + w * c[0] + ax * ox + tx * oy + nx * oz
        rows[VERTEX + LANES + i] = u * a[1] + v * b[1] + w * c[1] + ay * ox + ty * oy + ny * oz
        rows[VERTEX + 2 * LANES + i] = u * a[2] + v * b[2] + w * c[2] + az * ox + tz * oy + nz * oz
        rows[_FRAME + i], rows[_FRAME + LANES + i], rows[_FRAME + 2 * LANES + i] = ax, tx, nx
        rows[_FRAME + 3 * LANES + i], rows[_FRAME + 4 * LANES + i], rows[_FRAME + 5 * LANES + i] = ay, ty, ny
        rows[_FRAME + 6 * LANES + i], rows[_FRAME + 7 * LANES + i], rows[_FRAME + 8 * LANES + i] = az, tz, nz


@njit(cache=True, fastmath=FAST, error_model="numpy")
def compute_lengths(rest_edges: np.ndarray, rows: np.ndarray) -> None:
    """Length of whole strands [m], which is also what is beyond their roots."""
    for i in range(LANES):
        rows[_BEYOND + i] = np.float32(0.0)
    for edge in range(len(rest_edges)):
        for i in range(LANES):
            x, y, z = rest_edges[edge, 0, i], rest_edges[edge, 1, i], rest_edges[edge, 2, i]
            rows[_BEYOND + i] += np.sqrt(x * x + y * y + z * z)
    for i in range(LANES):
        rows[_WHOLE + i] = rows[_BEYOND + i]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def aim(
    rest_edges: np.ndarray, down: np.ndarray, weight: float, propagated: float, load: float, force: np.ndarray,
    rows: np.ndarray,
) -> None:  # fmt: skip
    """Directions of the next edges, posed, in equilibrium (`equilibrium_vectors`) and pushed, and their lengths."""
    half, one = np.float32(0.5), np.float32(1.0)
    gx, gy, gz = down[0], down[1], down[2]
    for i in range(LANES):
        ex, ey, ez = rest_edges[0, i], rest_edges[1, i], rest_edges[2, i]
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        inverse = one / max(length, np.float32(MIN_LENGTH))
        ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
        beyond = rows[_BEYOND + i] - length
        pull = weight * length * (beyond + half * length)
        x = rows[_FRAME + i] * ex + rows[_FRAME + LANES + i] * ey + rows[_FRAME + 2 * LANES + i] * ez
        y = rows[_FRAME + 3 * LANES + i] * ex + rows[_FRAME + 4 * LANES + i] * ey + rows[_FRAME + 5 * LANES + i] * ez
        z = rows[_FRAME + 6 * LANES + i] * ex + rows[_FRAME + 7 * LANES + i] * ey + rows[_FRAME + 8 * LANES + i] * ez
        x, y, z = x + pull * gx, y + pull * gy, z + pull * gz
        scale = one / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
        rows[_FREE + i], rows[_FREE + LANES + i], rows[_FREE + 2 * LANES + i] = x * scale, y * scale, z * scale
        px, py, pz = force[i], force[LANES + i], force[2 * LANES + i]
        share = propagated * length
        x, y, z = x + share * px, y + share * py, z + share * pz
        strength = np.sqrt(x * x + y * y + z * z)
        scale = one / max(strength, np.float32(MIN_LENGTH))
        rows[DIRECTION + i], rows[DIRECTION + LANES + i] = x * scale, y * scale
        rows[DIRECTION + 2 * LANES + i], rows[_STRENGTH + i] = z * scale, strength
        rows[COMPLIANCE + i] = pull + weight * length * load * rows[_WHOLE + i]
        rows[_LENGTH + i], rows[_BEYOND + i] = length, beyond


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
def deflect(margin: np.ndarray, radius: float, rows: np.ndarray) -> None:
    """Rotate edges out of the skin."""
    one, none = np.float32(1.0), np.float32(0.0)
    for i in range(LANES):
        mx, my, mz = rows[NORMAL + i], rows[NORMAL + LANES + i], rows[NORMAL + 2 * LANES + i]
        ux, uy, uz = rows[DIRECTION + i], rows[DIRECTION + LANES + i], rows[DIRECTION + 2 * LANES + i]
        depth = max(margin[i] * rows[WEIGHT + i] - radius * rows[HEIGHT + i], none)
        angle = depth / max(rows[_LENGTH + i], np.float32(MIN_LENGTH))
        ux, uy, uz = ux + angle * mx, uy + angle * my, uz + angle * mz
        norm = one / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
        rows[DIRECTION + i], rows[DIRECTION + LANES + i] = ux * norm, uy * norm
        rows[DIRECTION + 2 * LANES + i] = uz * norm


@njit(cache=True, fastmath=FAST, error_model="numpy")
def record_contact(contact: np.ndarray, rows: np.ndarray) -> None:
    """Write how hard the skin pushes edges that it has deflected, and its normals."""
    one = np.float32(1.0)
    for i in range(LANES):
        x, y, z = rows[NORMAL + i], rows[NORMAL + LANES + i], rows[NORMAL + 2 * LANES + i]
        scale = one / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
        x, y, z = x * scale, y * scale, z * scale
        dx, dy = rows[DIRECTION + i] - rows[_FREE + i], rows[DIRECTION + LANES + i] - rows[_FREE + LANES + i]
        dz = rows[DIRECTION + 2 * LANES + i] - rows[_FREE + 2 * LANES + i]
        strength = rows[_STRENGTH + i] / max(rows[_LENGTH + i], np.float32(MIN_LENGTH))
        contact[_OUT + i], contact[_OUT + LANES + i], contact[_OUT + 2 * LANES + i] = x, y, z
        contact[_HELD + i] = (dx * x + dy * y + dz * z) * strength


@njit(cache=True, fastmath=FAST, error_model="numpy")
def propagate(contact: np.ndarray, forces: np.ndarray) -> None:
    """Contact forces from tip to root (`propagate_contact_force`)."""
    none, last = np.float32(0.0), len(contact) - 1
    forces[last] = none
    for edge in range(last, -1, -1):
        touched, own, beyond = contact[edge], forces[edge], forces[min(edge + 1, last)]
        for i in range(LANES):
            x, y, z = beyond[i], beyond[LANES + i], beyond[2 * LANES + i]
            ox, oy, oz = touched[_OUT + i], touched[_OUT + LANES + i], touched[_OUT + 2 * LANES + i]
            force = max(touched[_HELD + i] - max(x * ox + y * oy + z * oz, none), none)
            own[i], own[LANES + i], own[2 * LANES + i] = x + force * ox, y + force * oy, z + force * oz


@njit(cache=True)
def gather(forces: np.ndarray, representative: np.ndarray, own_forces: np.ndarray) -> None:
    """Contact forces of the representatives of a block's strands."""
    for i in range(LANES):
        block, lane = representative[i] // LANES, representative[i] % LANES
        for edge in range(len(own_forces)):
            for axis in range(3):
                own_forces[edge, axis * LANES + i] = forces[block, edge, axis * LANES + lane]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def add_deflection(rows: np.ndarray) -> None:
    """Add to the compliance of edges how far the skin has deflected them; one at most."""
    for i in range(LANES):
        x, y = rows[DIRECTION + i] - rows[_FREE + i], rows[DIRECTION + LANES + i] - rows[_FREE + LANES + i]
        z = rows[DIRECTION + 2 * LANES + i] - rows[_FREE + 2 * LANES + i]
        rows[COMPLIANCE + i] = min(rows[COMPLIANCE + i] + np.sqrt(x * x + y * y + z * z), np.float32(1.0))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def advance(rows: np.ndarray) -> None:
    for i in range(LANES):
        length = rows[_LENGTH + i]
        rows[VERTEX + i] += length * rows[DIRECTION + i]
        rows[VERTEX + LANES + i] += length * rows[DIRECTION + LANES + i]
        rows[VERTEX + 2 * LANES + i] += length * rows[DIRECTION + 2 * LANES + i]


@njit(cache=True)
def write_features(rows: np.ndarray, row_of: np.ndarray, edge: int, count: int, features: np.ndarray) -> None:
    """Write the positions of the vertices beyond the edges, and their local features before contact."""
    bits, at, local, source = rows.view(np.uint32), 3 * edge, 3 * count + 5 * edge, 0
    if features.itemsize == 2:
        source = _ROUNDED
        _round(bits)
    for i in range(LANES):
        row = row_of[i]
        for axis in range(3):
            features[row, at + axis] = bits[source + VERTEX + axis * LANES + i]
            features[row, local + 1 + axis] = bits[source + NORMAL + axis * LANES + i]
        features[row, local] = bits[source + HEIGHT + i]
        features[row, local + 4] = bits[source + WEIGHT + i]


@njit(cache=True)
def _round(bits: np.ndarray) -> None:
    """float32 to bfloat16, to nearest even, in the lower half of each number of `_ROUNDED`."""
    for i in range(DIRECTION):
        odd = (bits[i] >> np.uint32(16)) & np.uint32(1)
        bits[_ROUNDED + i] = (bits[i] + np.uint32(0x7FFF) + odd) >> np.uint32(16)
