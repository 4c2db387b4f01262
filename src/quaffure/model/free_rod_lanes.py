"""Compiled twin of `quaffure.model.free_rod`: a strand in each lane of the processor's vectors, float32."""

from typing import Any

import numpy as np
from numba import njit

from quaffure.config import BENDING_STIFFNESS, TWISTING_STIFFNESS
from quaffure.geometry.mls_kernels import FAST, LANES
from quaffure.geometry.symmetric_matrix import symmetric_inverse, symmetric_times

TWIST_SHARE = TWISTING_STIFFNESS / BENDING_STIFFNESS
"""C over B."""
LEAST_STIFFNESS = 1e-4
"""Added to each edge's stiffness, relative to B: keeps the system positive definite."""
LARGEST_HALF_TURN = 1.0
"""Half the rotation of an edge in a pass up to which the series of the tangent is used [rad]."""
# Rows of an edge's input, each of `LANES` numbers (`FreeRods`): direction, moment, force, bending, goal, length; and
# two directions that `relax` does not read, the posed one and, after contact, that without it.
DIRECTION, MOMENT, FORCE, BENDING, GOAL, LENGTH, POSED, FREE, INPUTS = 0, 3, 6, 9, 10, 11, 12, 15, 18
# Rows of what a pass keeps of an edge: quaternion, and theta_i = theta_(i-1) - follows theta_(i-1) - shift.
_REAL, _IMAGINARY, _FOLLOWS, _SHIFT, STATE = 0, 1, 4, 13, 16
# Rows of what is passed on from edge to edge: force and moment beyond, blocks of the quadratic function, or theta.
_FORCE, _MOMENT, _BLOCK, _SLOPE, PASSED = 0, 3, 6, 12, 15
_ZERO, _HALF, _ONE, _TWO, _THIRD = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(1 / 3)
_FIFTHS, _AXIAL, _LEAST = np.float32(0.4), np.float32(TWIST_SHARE - 1), np.float32(LEAST_STIFFNESS)
_MOST = np.float32(LARGEST_HALF_TURN**2)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def relax(inputs: np.ndarray, passes: int, state: np.ndarray, passed: np.ndarray) -> None:
    """Passes from the posed design. Writes the directions of the edges over those in `inputs`.

    Args:
        inputs: [edge, `INPUTS`, lane].
        state, passed: workspaces, [edge, `STATE`, lane] and [`PASSED`, lane].
    """
    for edge in range(len(inputs)):
        for i in range(LANES):
            state[edge, _REAL, i] = _ONE
            for axis in range(3):
                state[edge, _IMAGINARY + axis, i] = _ZERO
    for _ in range(passes):
        passed[:] = _ZERO
        for edge in range(len(inputs) - 1, -1, -1):
            _eliminate(inputs[edge], state[edge], state[max(edge - 1, 0)], _ONE if edge > 0 else _ZERO, passed)
        passed[:3] = _ZERO
        for edge in range(len(inputs)):
            _substitute(state[edge], passed)
    for edge in range(len(inputs)):
        row, own = inputs[edge], state[edge]
        for i in range(LANES):
            quaternion = own[_REAL, i], own[_IMAGINARY, i], own[_IMAGINARY + 1, i], own[_IMAGINARY + 2, i]
            x, y, z = rotate(quaternion, row[DIRECTION, i], row[DIRECTION + 1, i], row[DIRECTION + 2, i])
            row[DIRECTION, i], row[DIRECTION + 1, i], row[DIRECTION + 2, i] = x, y, z


@njit(fastmath=FAST, error_model="numpy", inline="always")
def rotate(q: Any, x: Any, y: Any, z: Any) -> Any:
    a, b, c = _TWO * (q[2] * z - q[3] * y), _TWO * (q[3] * x - q[1] * z), _TWO * (q[1] * y - q[2] * x)
    return (
        x + q[0] * a + q[2] * c - q[3] * b,
        y + q[0] * b + q[3] * a - q[1] * c,
        z + q[0] * c + q[1] * b - q[2] * a,
    )


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _moment(row: Any, q: Any, p: Any, t: Any, i: int) -> Any:
    """M of the joint between an edge of rotation q and tangent t and one of rotation p."""
    # q p*, and twice its imaginary part.
    sign = _TWO if q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3] >= _ZERO else -_TWO
    x = sign * (q[1] * p[0] - q[0] * p[1] - q[2] * p[3] + q[3] * p[2])
    y = sign * (q[2] * p[0] - q[0] * p[2] + q[1] * p[3] - q[3] * p[1])
    z = sign * (q[3] * p[0] - q[0] * p[3] - q[1] * p[2] + q[2] * p[1])
    bend = row[BENDING, i]
    along = _AXIAL * bend * (x * t[0] + y * t[1] + z * t[2])
    mx, my, mz = rotate(p, row[MOMENT, i], row[MOMENT + 1, i], row[MOMENT + 2, i])
    return mx + bend * x + along * t[0], my + bend * y + along * t[1], mz + bend * z + along * t[2]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _eliminate(row: np.ndarray, own: np.ndarray, other: np.ndarray, moves: Any, passed: np.ndarray) -> None:
    """Take an edge into the quadratic function in `passed`, and eliminate its rotation.

    Args:
        other: state of the edge before; `moves` is 0 where that is the root, which stays.
    """
    for i in range(LANES):
        q = own[_REAL, i], own[_IMAGINARY, i], own[_IMAGINARY + 1, i], own[_IMAGINARY + 2, i]
        p = (
            moves * other[_REAL, i] + (_ONE - moves),
            moves * other[_IMAGINARY, i],
            moves * other[_IMAGINARY + 1, i],
            moves * other[_IMAGINARY + 2, i],
        )
        tx, ty, tz = rotate(q, row[DIRECTION, i], row[DIRECTION + 1, i], row[DIRECTION + 2, i])
        mx, my, mz = _moment(row, q, p, (tx, ty, tz), i)
        bend, goal, length = row[BENDING, i], row[GOAL, i], row[LENGTH, i]
        fx, fy = passed[_FORCE, i] + row[FORCE, i], passed[_FORCE + 1, i] + row[FORCE + 1, i]
        fz = passed[_FORCE + 2, i] + row[FORCE + 2, i]
        held = goal * (_TWO if q[0] >= _ZERO else -_TWO)
        gx = passed[_SLOPE, i] + mx - passed[_MOMENT, i] - length * (ty * fz - tz * fy) + held * q[1]
        gy = passed[_SLOPE + 1, i] + my - passed[_MOMENT + 1, i] - length * (tz * fx - tx * fz) + held * q[2]
        gz = passed[_SLOPE + 2, i] + mz - passed[_MOMENT + 2, i] - length * (tx * fy - ty * fx) + held * q[3]
        passed[_FORCE, i], passed[_FORCE + 1, i], passed[_FORCE + 2, i] = fx, fy, fz
        passed[_MOMENT, i], passed[_MOMENT + 1, i], passed[_MOMENT + 2, i] = mx, my, mz
        pull = fx * tx + fy * ty + fz * tz
        pull = length * _THIRD * (_TWO * np.sqrt(fx * fx + fy * fy + fz * fz) + pull)
        least, axial = goal + _LEAST * bend, _AXIAL * bend
        a, b = passed[_BLOCK, i] + pull * (_ONE - tx * tx) + least, passed[_BLOCK + 1, i] - pull * ty * tx
        c, d = passed[_BLOCK + 2, i] + pull * (_ONE - ty * ty) + least, passed[_BLOCK + 3, i] - pull * tz * tx
        e, f = passed[_BLOCK + 4, i] - pull * tz * ty, passed[_BLOCK + 5, i] + pull * (_ONE - tz * tz) + least
        block = a, b, c, d, e, f
        both = (
            a + bend + axial * tx * tx,
            b + axial * ty * tx,
            c + bend + axial * ty * ty,
            d + axial * tz * tx,
            e + axial * tz * ty,
            f + bend + axial * tz * tz,
        )
        v = symmetric_inverse(both, _LEAST * bend)
        # With S the sum of D and the block Q: S^-1 Q, and Q - Q S^-1 Q, in which short edges lose no digits.
        x, y, z = symmetric_times(v, (a, b, d)), symmetric_times(v, (b, c, e)), symmetric_times(v, (d, e, f))
        for k in range(3):
            row_of = _FOLLOWS + 3 * k
            own[row_of, i], own[row_of + 1, i], own[row_of + 2, i] = x[k], y[k], z[k]
        s = symmetric_times(v, (gx, gy, gz))
        own[_SHIFT, i], own[_SHIFT + 1, i], own[_SHIFT + 2, i] = s[0], s[1], s[2]
        x, y, z = symmetric_times(block, x), symmetric_times(block, y), symmetric_times(block, z)
        passed[_BLOCK, i], passed[_BLOCK + 1, i], passed[_BLOCK + 2, i] = a - x[0], b - x[1], c - y[1]
        passed[_BLOCK + 3, i], passed[_BLOCK + 4, i], passed[_BLOCK + 5, i] = d - x[2], e - y[2], f - z[2]
        x = symmetric_times(block, s)
        passed[_SLOPE, i], passed[_SLOPE + 1, i], passed[_SLOPE + 2, i] = gx - x[0], gy - x[1], gz - x[2]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _substitute(own: np.ndarray, theta: np.ndarray) -> None:
    """Rotate an edge; `theta` holds the rotation of the edge before, and then its own."""
    for i in range(LANES):
        x, y, z = theta[0, i], theta[1, i], theta[2, i]
        a = x - (own[_FOLLOWS, i] * x + own[_FOLLOWS + 1, i] * y + own[_FOLLOWS + 2, i] * z) - own[_SHIFT, i]
        b = y - (own[_FOLLOWS + 3, i] * x + own[_FOLLOWS + 4, i] * y + own[_FOLLOWS + 5, i] * z) - own[_SHIFT + 1, i]
        c = z - (own[_FOLLOWS + 6, i] * x + own[_FOLLOWS + 7, i] * y + own[_FOLLOWS + 8, i] * z) - own[_SHIFT + 2, i]
        theta[0, i], theta[1, i], theta[2, i] = a, b, c
        a, b, c = _HALF * a, _HALF * b, _HALF * c
        square = min(a * a + b * b + c * c, _MOST)
        scale = _ONE + _THIRD * square * (_ONE + _FIFTHS * square)
        a, b, c = scale * a, scale * b, scale * c
        w, x, y, z = own[_REAL, i], own[_IMAGINARY, i], own[_IMAGINARY + 1, i], own[_IMAGINARY + 2, i]
        p, q, r, s = (
            w - a * x - b * y - c * z,
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
        )
        scale = _ONE / np.sqrt(p * p + q * q + r * r + s * s)
        own[_REAL, i], own[_IMAGINARY, i] = scale * p, scale * q
        own[_IMAGINARY + 1, i], own[_IMAGINARY + 2, i] = scale * r, scale * s
