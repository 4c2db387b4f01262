"""Compiled parts of `quaffure.geometry.mls_surface`: sixteen positions at once, one in each lane of the vectors."""

import numpy as np
from numba import njit

LEAF = 8
"""Points that are near each other and listed together."""
MIN_WEIGHT = 0.02
"""Sum of weights at which features are halved: far from all points every channel fades to zero."""
MIN_LENGTH = 1e-12
"""Length that an edge is taken to have at least [m]."""
LANES = 16
"""Positions that are evaluated at once, one in each lane of the processor's vectors."""
# Rows of an evaluation, each of `LANES` numbers: position [radii], sum of weights, weighted sum of normals, weighted
# sum of the points' heights along their own normals.
POSITION, WEIGHT, NORMAL, HEIGHT = 0, 3 * LANES, 4 * LANES, 7 * LANES
ROWS = 8 * LANES
UNROLL = 2
"""Points whose sums stay in registers."""
_FAR = np.float32(1e9)  # position of the point that has no weight anywhere


FAST = {"contract", "nnan", "ninf", "nsz", "arcp"}
"""Fast arithmetic but for `reassoc`: a sum does not depend on where in the list its points stand."""


@njit(cache=True, error_model="numpy")
def record_points(
    positions: np.ndarray, normals: np.ndarray, per_radius: np.float32, records: np.ndarray, scaled: np.ndarray
) -> None:
    """Lay points out for `evaluate`, in units of their radius.

    Args:
        records: filled with a point's position, normal, height along its normal, and a zero; at the end with a point
            that has no weight anywhere.
        scaled: filled with x of all points, then y, then z.
    """
    for sample in range(len(positions)):
        for index in range(positions.shape[1]):
            for axis in range(3):
                position, normal = positions[sample, index, axis] * per_radius, normals[sample, index, axis]
                scaled[sample, axis, index] = position
                records[sample, index, axis] = position
                records[sample, index, 3 + axis] = normal
                records[sample, index, 6] += position * normal
        records[sample, -1] = _FAR


@njit(cache=True, fastmath=FAST, error_model="numpy")
def list_points(
    centre: np.ndarray, distance: np.float32, positions: np.ndarray, inside: np.ndarray, near: np.ndarray
) -> int:
    """List the points within a distance of a centre, then the one without weight up to a multiple of `UNROLL`.

    Args:
        inside: workspace, a byte a point.
        near: filled with indices.

    Returns:
        How many are listed.
    """
    count, listed = positions.shape[1], 0
    cx, cy, cz, square = centre[0], centre[1], centre[2], distance * distance
    for k in range(count):
        dx, dy, dz = positions[0, k] - cx, positions[1, k] - cy, positions[2, k] - cz
        inside[k] = dx * dx + dy * dy + dz * dz < square
    leaves = inside.view(np.uint64)
    for leaf in range(count // LEAF):
        if leaves[leaf] != 0:
            for k in range(leaf * LEAF, (leaf + 1) * LEAF):
                near[listed] = k  # kept by the count alone: cheaper than a branch that cannot be predicted
                listed += inside[k]
    while listed % UNROLL != 0:
        near[listed] = count
        listed += 1
    return listed


@njit(cache=True, fastmath=FAST, error_model="numpy")
def evaluate(records: np.ndarray, near: np.ndarray, listed: int, lanes: np.ndarray) -> None:
    """Weighted sums at `LANES` positions over the first `listed` points in `near`: fills the rows from `WEIGHT` on.

    Args:
        near: indices; `listed` is a multiple of `UNROLL`.
        lanes: a position in each lane of the rows from `POSITION` on.
    """
    none, one = np.float32(0.0), np.float32(1.0)
    for i in range(5 * LANES):
        lanes[WEIGHT + i] = none
    for first in range(0, listed, UNROLL):
        a, b = near[first], near[first + 1]
        # Read here, or the compiler has to make sure before every loop that no lane is part of a point.
        ax, ay, az, bx, by, bz = (
            records[a, 0],
            records[a, 1],
            records[a, 2],
            records[b, 0],
            records[b, 1],
            records[b, 2],
        )
        au, av, aw, bu, bv, bw = (
            records[a, 3],
            records[a, 4],
            records[a, 5],
            records[b, 3],
            records[b, 4],
            records[b, 5],
        )
        ah, bh = records[a, 6], records[b, 6]
        for i in range(LANES):
            x, y, z = lanes[POSITION + i], lanes[POSITION + LANES + i], lanes[POSITION + 2 * LANES + i]
            dx, dy, dz = x - ax, y - ay, z - az
            p = max(one - dx * dx - dy * dy - dz * dz, none)
            p *= p
            p *= p
            dx, dy, dz = x - bx, y - by, z - bz
            q = max(one - dx * dx - dy * dy - dz * dz, none)
            q *= q
            q *= q
            lanes[WEIGHT + i] = lanes[WEIGHT + i] + p + q
            lanes[NORMAL + i] = lanes[NORMAL + i] + p * au + q * bu
            lanes[NORMAL + LANES + i] = lanes[NORMAL + LANES + i] + p * av + q * bv
            lanes[NORMAL + 2 * LANES + i] = lanes[NORMAL + 2 * LANES + i] + p * aw + q * bw
            lanes[HEIGHT + i] = lanes[HEIGHT + i] + p * ah + q * bh


@njit(cache=True, fastmath=FAST, error_model="numpy")
def normalize_features(lanes: np.ndarray) -> None:
    """Means of the sums of `evaluate`: `HEIGHT` is then above the surface, `WEIGHT` the share of weight."""
    for i in range(LANES):
        whole = lanes[WEIGHT + i]
        scale = np.float32(1.0) / (whole + np.float32(MIN_WEIGHT))
        mx, my, mz = lanes[NORMAL + i], lanes[NORMAL + LANES + i], lanes[NORMAL + 2 * LANES + i]
        x, y, z = lanes[POSITION + i], lanes[POSITION + LANES + i], lanes[POSITION + 2 * LANES + i]
        lanes[HEIGHT + i] = (x * mx + y * my + z * mz - lanes[HEIGHT + i]) * scale
        lanes[WEIGHT + i] = whole * scale
        lanes[NORMAL + i], lanes[NORMAL + LANES + i], lanes[NORMAL + 2 * LANES + i] = mx * scale, my * scale, mz * scale
