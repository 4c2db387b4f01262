"""Compiled twin of `quaffure.model.bend_relaxation`: a strand in each lane of the processor's vectors, float32."""

import numpy as np
from numba import njit

from quaffure.geometry.mls_kernels import FAST, LANES
from quaffure.geometry.rotation_kernel import rotated_by_gibbs
from quaffure.model import free_rod_lanes as rod

LEAST_ALIGNMENT = 1e-3
"""Least 1 + cosine of a bend, whose rotation vector is undefined where an edge folds back."""
# Rows of what is kept of an edge: bend, and theta_i = follows theta_(i-1) - shift.
_BEND, _FOLLOWS, _SHIFT = 0, 3, 4
# Rows of what is passed on: stiffness and slope of the quadratic function beyond.
_STIFFNESS, _SLOPE = 0, 1
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_LEAST = np.float32(LEAST_ALIGNMENT)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def relax_bends(inputs: np.ndarray, relaxation: float | np.floating, state: np.ndarray, passed: np.ndarray) -> None:
    """Relax the bends of the directions in `inputs` relative to the free ones there.

    Args:
        inputs: [edge, `free_rod_lanes.INPUTS`, lane].
        relaxation: r, above 0.
        state, passed: workspaces of `free_rod_lanes.relax`.
    """
    passed[0] = _ONE
    passed[1:4] = _ZERO
    for edge in range(len(inputs)):
        _bend(inputs[edge], state[edge], passed)
    passed[:4] = _ZERO
    hold = _ONE / relaxation
    for edge in range(len(inputs) - 1, -1, -1):
        _eliminate(inputs[edge], hold, state[edge], passed)
    passed[:3] = _ZERO
    for edge in range(len(inputs)):
        _substitute(inputs[edge], state[edge], passed)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _bend(row: np.ndarray, own: np.ndarray, rotation: np.ndarray) -> None:
    """Bend before an edge; `rotation` is that of the edge before from its free direction, and then its own."""
    for i in range(LANES):
        q = rotation[0, i], rotation[1, i], rotation[2, i], rotation[3, i]
        a, b, c = rod.rotate(q, row[rod.FREE, i], row[rod.FREE + 1, i], row[rod.FREE + 2, i])
        x, y, z = row[rod.DIRECTION, i], row[rod.DIRECTION + 1, i], row[rod.DIRECTION + 2, i]
        real = max(_ONE + a * x + b * y + c * z, _LEAST)
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        scale = _ONE / np.sqrt(real * real + u * u + v * v + w * w)
        real, u, v, w = scale * real, scale * u, scale * v, scale * w
        own[_BEND, i], own[_BEND + 1, i], own[_BEND + 2, i] = _TWO * u, _TWO * v, _TWO * w
        rotation[0, i] = real * q[0] - u * q[1] - v * q[2] - w * q[3]
        rotation[1, i] = real * q[1] + u * q[0] + v * q[3] - w * q[2]
        rotation[2, i] = real * q[2] + v * q[0] + w * q[1] - u * q[3]
        rotation[3, i] = real * q[3] + w * q[0] + u * q[2] - v * q[1]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _eliminate(row: np.ndarray, hold: float | np.floating, own: np.ndarray, passed: np.ndarray) -> None:
    """Take an edge into the quadratic function in `passed`, and eliminate its rotation."""
    for i in range(LANES):
        joint = row[rod.BENDING, i]
        stiffness = joint * hold + row[rod.GOAL, i] + passed[_STIFFNESS, i]
        follows = joint / (joint + stiffness)
        share = _ONE / (joint + stiffness)
        own[_FOLLOWS, i], passed[_STIFFNESS, i] = follows, follows * stiffness
        for axis in range(3):
            bend, slope = own[_BEND + axis, i], passed[_SLOPE + axis, i]
            own[_SHIFT + axis, i] = share * (joint * bend + slope)
            passed[_SLOPE + axis, i] = follows * (slope - stiffness * bend)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _substitute(row: np.ndarray, own: np.ndarray, theta: np.ndarray) -> None:
    """Rotate an edge; `theta` holds the rotation of the edge before, and then its own."""
    for i in range(LANES):
        follows = own[_FOLLOWS, i]
        a = follows * theta[0, i] - own[_SHIFT, i]
        b = follows * theta[1, i] - own[_SHIFT + 1, i]
        c = follows * theta[2, i] - own[_SHIFT + 2, i]
        theta[0, i], theta[1, i], theta[2, i] = a, b, c
        edge = row[rod.DIRECTION, i], row[rod.DIRECTION + 1, i], row[rod.DIRECTION + 2, i]
        x, y, z = rotated_by_gibbs((_HALF * a, _HALF * b, _HALF * c), edge)
        row[rod.DIRECTION, i], row[rod.DIRECTION + 1, i], row[rod.DIRECTION + 2, i] = x, y, z
