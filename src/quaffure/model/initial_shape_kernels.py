"""The kernels before the network, a packet of strands in the lanes of the processor's vectors.

`feel` is the first slide, of the leading strands alone, and `grow` the second, of all of them; their torch twin is in
`quaffure.model.initial_shape`. Shapes cannot be checked at run time inside compiled code, hence `no_type_check`.
"""

from typing import no_type_check

import numpy as np
from numba import njit, prange

from quaffure.geometry.mls_surface import (
    AT_ONCE,
    FAST,
    HEIGHT,
    LANES,
    LOOK_SIZE,
    NORMAL,
    PLACE,
    SHORTEST,
    WEIGHT,
    list_near,
    look,
    normalize_features,
)

# How much farther than needed a packet's list of skin points reaches, and how far ahead its centre is [radii].
_SLACK, _AHEAD = 0.1, 0.15

PROPAGATED_SHARE = 0.3
"""Of what the skin pushes an edge with, the share that turns it and the edges above before the second slide. All of it
would swing the strand off the skin, as edges above hold those below as well; docs/training.md has other shares."""
SHARE = 0.2
"""Of a strand's weight that other hair or the skin may push an edge with, besides the weight beyond the edge."""

# Rows of a packet after those of `look`.
_VERTEX = LOOK_SIZE
_DIRECTION = _VERTEX + 3 * LANES
_LENGTH = _DIRECTION + 3 * LANES
_BEYOND = _LENGTH + LANES
_WHOLE = _BEYOND + LANES
_SAG = _WHOLE + LANES
_COMPLIANCE = _SAG + 3 * LANES
_STRENGTH = _COMPLIANCE + LANES
_FRAME = _STRENGTH + LANES
_TOLD = _FRAME + 9 * LANES  # as many as before `_DIRECTION`, as the network is told them
_ROWS = _TOLD + _DIRECTION
# Rows of an edge's contact: the skin's normal, and how hard the skin holds its end alone, over k_Cosserat [1/m].
_OUT, _HELD, _CONTACT_SIZE = 0, 3 * LANES, 4 * LANES


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def feel(
    rest_edges: np.ndarray, offset: np.ndarray, corners: np.ndarray, barycentric: np.ndarray, margin: np.ndarray,
    scalp: np.ndarray, down: np.ndarray, points: np.ndarray, places: np.ndarray,
    radius: float, weight: float, threads: int, push: np.ndarray,
) -> None:  # fmt: skip
    """Resolve contact as if nothing pushed, and fill what the skin pushes each edge with (`propagate_contact_force`).

    Args:
        push: [body, packet, edge, axis and lane], over k_Cosserat [1/m]; the other arguments are those of `grow`.
    """
    batch, packets, count = len(scalp), len(rest_edges), rest_edges.shape[1]
    # Made outside of the parallel loop, where arrays are not counted: counting costs as much as looking.
    room, contacts = np.empty((threads, _ROWS), np.float32), np.empty((threads, count, _CONTACT_SIZE), np.float32)
    covers, flags = np.empty((threads, 4), np.float32), np.empty((threads, places.shape[2]), np.uint8)
    lists, none = np.empty((threads, points.shape[1] + AT_ONCE), np.uint32), np.zeros(3 * LANES, np.float32)
    for thread in prange(threads):
        rows, contact, cover, inside, near = (
            room[thread],
            contacts[thread],
            covers[thread],
            flags[thread],
            lists[thread],
        )
        for item in range(thread, batch * packets, threads):
            sample, packet = item // packets, item % packets
            own_edges, own_margin, own_down = rest_edges[packet], margin[packet], down[sample]
            own_points, own_places = points[sample], places[sample]
            _place_roots(corners[packet], barycentric[packet], offset[packet], scalp[sample], rows)
            _measure(own_edges, rows)
            cover[3], listed = np.float32(-1.0), 0
            for edge in range(count):
                _aim(own_edges, edge, own_down, weight, none, rows)
                listed = _see(own_points, own_places, radius, cover, listed, inside, near, rows)
                _turn(own_margin, edge, radius, rows)
                _touch(contact[edge], rows)
                _advance(rows)
            _hand_back(contact, push[sample, packet])


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def grow(
    rest_edges: np.ndarray, offset: np.ndarray, corners: np.ndarray, barycentric: np.ndarray, margin: np.ndarray,
    scalp: np.ndarray, down: np.ndarray, points: np.ndarray, places: np.ndarray,
    radius: float, weight: float, threads: int, push: np.ndarray, leader: np.ndarray, row_of: np.ndarray,
    roots: np.ndarray, edges: np.ndarray, compliance: np.ndarray, told: np.ndarray,
) -> None:  # fmt: skip
    """Fill roots, edges, their compliance and the network's features, see `quaffure.model.initial_shape.InitialShape`.

    Args:
        down: unit, in the head's frame.
        radius: of the softened body's points [m].
        weight: of a strand over k_Cosserat [1/m^2].
        push: of the leading strands, as `feel` has filled it.
        leader: [packet, lane], place of the one that leads each strand among the lanes of `push`.
        row_of: [packet, lane], of the results for each strand.
        told: the bits of float32, or of bfloat16.
    """
    batch, packets, count = len(scalp), len(row_of), rest_edges.shape[1]
    room, pushes = np.empty((threads, _ROWS), np.float32), np.empty((threads, count, 3 * LANES), np.float32)
    covers, flags = np.empty((threads, 4), np.float32), np.empty((threads, places.shape[2]), np.uint8)
    lists = np.empty((threads, points.shape[1] + AT_ONCE), np.uint32)
    for thread in prange(threads):
        rows, own_push, cover, inside, near = room[thread], pushes[thread], covers[thread], flags[thread], lists[thread]
        for item in range(thread, batch * packets, threads):
            sample, packet = item // packets, item % packets
            own_rows, own_points, own_places, own_told = row_of[packet], points[sample], places[sample], told[sample]
            own_edges, own_margin, own_down, out = rest_edges[packet], margin[packet], down[sample], edges[sample]
            own_compliance, own_roots = compliance[sample], roots[sample]
            _place_roots(corners[packet], barycentric[packet], offset[packet], scalp[sample], rows)
            for i in range(LANES):
                for axis in range(3):
                    own_roots[own_rows[i], axis] = rows[_VERTEX + axis * LANES + i]
            _follow(push[sample], leader[packet], own_push)
            _measure(own_edges, rows)
            cover[3], listed = np.float32(-1.0), 0
            for edge in range(count):
                _aim(own_edges, edge, own_down, weight, own_push[edge], rows)
                listed = _see(own_points, own_places, radius, cover, listed, inside, near, rows)
                _turn(own_margin, edge, radius, rows)
                _advance(rows)
                _comply(rows)
                for i in range(LANES):
                    own_compliance[own_rows[i], edge] = rows[_COMPLIANCE + i]
                    for axis in range(3):
                        out[own_rows[i], edge, axis] = rows[_DIRECTION + axis * LANES + i]
                _tell(rows, own_rows, edge, count, own_told)


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _place_roots(
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
        rows[_VERTEX + i] = u * a[0] + v * b[0] + w * c[0] + ax * ox + tx * oy + nx * oz
        rows[_VERTEX + LANES + i] = u * a[1] + v * b[1] + w * c[1] + ay * ox + ty * oy + ny * oz
        rows[_VERTEX + 2 * LANES + i] = u * a[2] + v * b[2] + w * c[2] + az * ox + tz * oy + nz * oz
        rows[_FRAME + i], rows[_FRAME + LANES + i], rows[_FRAME + 2 * LANES + i] = ax, tx, nx
        rows[_FRAME + 3 * LANES + i], rows[_FRAME + 4 * LANES + i], rows[_FRAME + 5 * LANES + i] = ay, ty, ny
        rows[_FRAME + 6 * LANES + i], rows[_FRAME + 7 * LANES + i], rows[_FRAME + 8 * LANES + i] = az, tz, nz


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _measure(rest_edges: np.ndarray, rows: np.ndarray) -> None:
    """Length of whole strands [m], which is also what is beyond their roots."""
    for i in range(LANES):
        rows[_BEYOND + i] = np.float32(0.0)
    for edge in range(len(rest_edges)):
        for i in range(LANES):
            x, y, z = rest_edges[edge, 0, i], rest_edges[edge, 1, i], rest_edges[edge, 2, i]
            rows[_BEYOND + i] += np.sqrt(x * x + y * y + z * z)
    for i in range(LANES):
        rows[_WHOLE + i] = rows[_BEYOND + i]


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _aim(
    rest_edges: np.ndarray, edge: int, down: np.ndarray, weight: float, push: np.ndarray, rows: np.ndarray
) -> None:
    """Directions of the next edges, posed, sagged (`equilibrium_vectors`) and pushed, and their lengths."""
    half, one = np.float32(0.5), np.float32(1.0)
    gx, gy, gz = down[0], down[1], down[2]
    for i in range(LANES):
        ex, ey, ez = rest_edges[edge, 0, i], rest_edges[edge, 1, i], rest_edges[edge, 2, i]
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        inverse = one / max(length, np.float32(SHORTEST))
        ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
        beyond = rows[_BEYOND + i] - length
        pull = weight * length * (beyond + half * length)
        x = rows[_FRAME + i] * ex + rows[_FRAME + LANES + i] * ey + rows[_FRAME + 2 * LANES + i] * ez
        y = rows[_FRAME + 3 * LANES + i] * ex + rows[_FRAME + 4 * LANES + i] * ey + rows[_FRAME + 5 * LANES + i] * ez
        z = rows[_FRAME + 6 * LANES + i] * ex + rows[_FRAME + 7 * LANES + i] * ey + rows[_FRAME + 8 * LANES + i] * ez
        x, y, z = x + pull * gx, y + pull * gy, z + pull * gz
        scale = one / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
        rows[_SAG + i], rows[_SAG + LANES + i], rows[_SAG + 2 * LANES + i] = x * scale, y * scale, z * scale
        px, py, pz = push[i], push[LANES + i], push[2 * LANES + i]
        share = np.float32(PROPAGATED_SHARE) * length
        x, y, z = x + share * px, y + share * py, z + share * pz
        strength = np.sqrt(x * x + y * y + z * z)
        scale = one / max(strength, np.float32(SHORTEST))
        rows[_DIRECTION + i], rows[_DIRECTION + LANES + i] = x * scale, y * scale
        rows[_DIRECTION + 2 * LANES + i], rows[_STRENGTH + i] = z * scale, strength
        rows[_COMPLIANCE + i] = pull + weight * length * np.float32(SHARE) * rows[_WHOLE + i]
        rows[_LENGTH + i], rows[_BEYOND + i] = length, beyond


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _step(radius: float, rows: np.ndarray) -> None:
    """Where the edges would end."""
    per_radius = np.float32(1.0) / radius
    for i in range(LANES):
        length = rows[_LENGTH + i]
        x, y, z = rows[_DIRECTION + i], rows[_DIRECTION + LANES + i], rows[_DIRECTION + 2 * LANES + i]
        rows[PLACE + i] = (rows[_VERTEX + i] + length * x) * per_radius
        rows[PLACE + LANES + i] = (rows[_VERTEX + LANES + i] + length * y) * per_radius
        rows[PLACE + 2 * LANES + i] = (rows[_VERTEX + 2 * LANES + i] + length * z) * per_radius


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _see(
    points: np.ndarray, places: np.ndarray, radius: float, cover: np.ndarray, listed: int,
    inside: np.ndarray, near: np.ndarray, rows: np.ndarray,
) -> int:  # fmt: skip
    """Look from where the edges would end; lists points anew where one ends outside of `cover`, a centre and radius.

    Returns how many are listed.
    """
    _step(radius, rows)
    if _outside(cover, rows):
        _recentre(cover, rows)
        cover[3] = _farthest(cover, rows) + np.float32(_SLACK)
        listed = list_near(cover, np.float32(1.0) + cover[3], places, inside, near)
    look(points, near, listed, rows)
    normalize_features(rows)
    return listed


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _outside(cover: np.ndarray, rows: np.ndarray) -> bool:
    """Whether any place is outside of a sphere, a centre and a radius; always if that is negative."""
    cx, cy, cz, square, outside = cover[0], cover[1], cover[2], cover[3] * cover[3], 0
    for i in range(LANES):
        x, y, z = rows[PLACE + i] - cx, rows[PLACE + LANES + i] - cy, rows[PLACE + 2 * LANES + i] - cz
        outside += x * x + y * y + z * z > square
    return outside > 0 or cover[3] < np.float32(0.0)


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _farthest(centre: np.ndarray, rows: np.ndarray) -> float:
    """How far away the farthest place is."""
    cx, cy, cz, farthest = centre[0], centre[1], centre[2], np.float32(0.0)
    for i in range(LANES):
        x, y, z = rows[PLACE + i] - cx, rows[PLACE + LANES + i] - cy, rows[PLACE + 2 * LANES + i] - cz
        farthest = max(farthest, x * x + y * y + z * z)
    return np.sqrt(farthest)


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _recentre(centre: np.ndarray, rows: np.ndarray) -> None:
    """Move the centre amid the places and a little on, the way that the strand in the middle goes."""
    for axis in range(3):
        low, high = rows[PLACE + axis * LANES], rows[PLACE + axis * LANES]
        for i in range(1, LANES):
            low, high = min(low, rows[PLACE + axis * LANES + i]), max(high, rows[PLACE + axis * LANES + i])
        ahead = np.float32(_AHEAD) * rows[_DIRECTION + axis * LANES + LANES // 2]
        centre[axis] = np.float32(0.5) * (low + high) + ahead


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _turn(margin: np.ndarray, edge: int, radius: float, rows: np.ndarray) -> None:
    """Turn edges out of the skin."""
    one, none = np.float32(1.0), np.float32(0.0)
    for i in range(LANES):
        mx, my, mz = rows[NORMAL + i], rows[NORMAL + LANES + i], rows[NORMAL + 2 * LANES + i]
        ux, uy, uz = rows[_DIRECTION + i], rows[_DIRECTION + LANES + i], rows[_DIRECTION + 2 * LANES + i]
        short = max(margin[edge, i] * rows[WEIGHT + i] - radius * rows[HEIGHT + i], none)
        turn = short / max(rows[_LENGTH + i], np.float32(SHORTEST))
        ux, uy, uz = ux + turn * mx, uy + turn * my, uz + turn * mz
        norm = one / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
        rows[_DIRECTION + i], rows[_DIRECTION + LANES + i] = ux * norm, uy * norm
        rows[_DIRECTION + 2 * LANES + i] = uz * norm


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _touch(contact: np.ndarray, rows: np.ndarray) -> None:
    """Write down how hard the skin pushes edges that it has turned, and its normals."""
    one = np.float32(1.0)
    for i in range(LANES):
        x, y, z = rows[NORMAL + i], rows[NORMAL + LANES + i], rows[NORMAL + 2 * LANES + i]
        scale = one / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
        x, y, z = x * scale, y * scale, z * scale
        dx, dy = rows[_DIRECTION + i] - rows[_SAG + i], rows[_DIRECTION + LANES + i] - rows[_SAG + LANES + i]
        dz = rows[_DIRECTION + 2 * LANES + i] - rows[_SAG + 2 * LANES + i]
        strength = rows[_STRENGTH + i] / max(rows[_LENGTH + i], np.float32(SHORTEST))
        contact[_OUT + i], contact[_OUT + LANES + i], contact[_OUT + 2 * LANES + i] = x, y, z
        contact[_HELD + i] = (dx * x + dy * y + dz * z) * strength


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _hand_back(contact: np.ndarray, push: np.ndarray) -> None:
    """From the tips up, push every edge with what the skin pushes those beyond it (`propagate_contact_force`)."""
    none, last = np.float32(0.0), len(contact) - 1
    push[last] = none
    for edge in range(last, -1, -1):
        touched, own, beyond = contact[edge], push[edge], push[min(edge + 1, last)]
        for i in range(LANES):
            x, y, z = beyond[i], beyond[LANES + i], beyond[2 * LANES + i]
            ox, oy, oz = touched[_OUT + i], touched[_OUT + LANES + i], touched[_OUT + 2 * LANES + i]
            force = max(touched[_HELD + i] - max(x * ox + y * oy + z * oz, none), none)
            own[i], own[LANES + i], own[2 * LANES + i] = x + force * ox, y + force * oy, z + force * oz


@no_type_check
@njit(cache=True)
def _follow(push: np.ndarray, leader: np.ndarray, own_push: np.ndarray) -> None:
    """What the leaders of a packet's strands are pushed with."""
    for i in range(LANES):
        packet, lane = leader[i] // LANES, leader[i] % LANES
        for edge in range(len(own_push)):
            for axis in range(3):
                own_push[edge, axis * LANES + i] = push[packet, edge, axis * LANES + lane]


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _comply(rows: np.ndarray) -> None:
    """Add to the compliance of edges how far the skin has turned them; one at most."""
    for i in range(LANES):
        x, y = rows[_DIRECTION + i] - rows[_SAG + i], rows[_DIRECTION + LANES + i] - rows[_SAG + LANES + i]
        z = rows[_DIRECTION + 2 * LANES + i] - rows[_SAG + 2 * LANES + i]
        rows[_COMPLIANCE + i] = min(rows[_COMPLIANCE + i] + np.sqrt(x * x + y * y + z * z), np.float32(1.0))


@no_type_check
@njit(cache=True, fastmath=FAST, error_model="numpy")
def _advance(rows: np.ndarray) -> None:
    for i in range(LANES):
        length = rows[_LENGTH + i]
        rows[_VERTEX + i] += length * rows[_DIRECTION + i]
        rows[_VERTEX + LANES + i] += length * rows[_DIRECTION + LANES + i]
        rows[_VERTEX + 2 * LANES + i] += length * rows[_DIRECTION + 2 * LANES + i]


@no_type_check
@njit(cache=True)
def _tell(rows: np.ndarray, row_of: np.ndarray, edge: int, count: int, told: np.ndarray) -> None:
    """Write where the vertices beyond the edges are, and what they saw before the edges turned."""
    bits, at, view, source = rows.view(np.uint32), 3 * edge, 3 * count + 5 * edge, 0
    if told.itemsize == 2:
        source = _TOLD
        _round(bits)
    for i in range(LANES):
        row = row_of[i]
        for axis in range(3):
            told[row, at + axis] = bits[source + _VERTEX + axis * LANES + i]
            told[row, view + 1 + axis] = bits[source + NORMAL + axis * LANES + i]
        told[row, view] = bits[source + HEIGHT + i]
        told[row, view + 4] = bits[source + WEIGHT + i]


@no_type_check
@njit(cache=True)
def _round(bits: np.ndarray) -> None:
    """float32 to bfloat16, to nearest even, in the lower half of each number of `_TOLD`."""
    for i in range(_DIRECTION):
        odd = (bits[i] >> np.uint32(16)) & np.uint32(1)
        bits[_TOLD + i] = (bits[i] + np.uint32(0x7FFF) + odd) >> np.uint32(16)
