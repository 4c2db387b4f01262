"""Steps of `quaffure.model.bend_relaxation` at one edge, in single precision. Kernels inline them."""

from typing import Any

import numpy as np
from numba import njit

from quaffure.geometry.mls_kernels import FAST
from quaffure.geometry.rotation_kernel import Vector, rotated_by_gibbs
from quaffure.model.free_rod_lanes import rotate

LEAST_ALIGNMENT = 1e-3
"""Least 1 + cosine of a bend, whose rotation vector is undefined where an edge folds back."""
_HALF, _ONE, _TWO, _LEAST = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(LEAST_ALIGNMENT)


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def bend_before(rotation: Any, free: Vector, direction: Vector) -> Any:
    """Bend before an edge as a rotation vector, and the rotation of the edge from its free direction (quaternion).

    Args:
        rotation: of the edge before from its free direction (quaternion).
        free, direction: unit vectors of the edge without contact and with it.
    """
    a, b, c = rotate(rotation, free[0], free[1], free[2])
    x, y, z = direction
    real = max(_ONE + a * x + b * y + c * z, _LEAST)
    u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
    scale = _ONE / np.sqrt(real * real + u * u + v * v + w * w)
    real, u, v, w = scale * real, scale * u, scale * v, scale * w
    whole = (
        real * rotation[0] - u * rotation[1] - v * rotation[2] - w * rotation[3],
        real * rotation[1] + u * rotation[0] + v * rotation[3] - w * rotation[2],
        real * rotation[2] + v * rotation[0] + w * rotation[1] - u * rotation[3],
        real * rotation[3] + w * rotation[0] + u * rotation[2] - v * rotation[1],
    )
    return (_TWO * u, _TWO * v, _TWO * w), whole


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def eliminated(bend: Vector, slope: Vector, joint: Any, stiffness: Any) -> Any:
    """Rotation of an edge as a function of that before it, theta_i = follows theta_(i-1) - shift, and the slope of what
    remains: follows, shift, slope.

    Args:
        bend: before the edge.
        slope: of the quadratic function of the edge's rotation, from what follows on it.
        joint: B of the joint before the edge.
        stiffness: of that function, with the edge's own.
    """
    share = _ONE / (joint + stiffness)
    follows = share * joint
    shift = (
        share * (joint * bend[0] + slope[0]),
        share * (joint * bend[1] + slope[1]),
        share * (joint * bend[2] + slope[2]),
    )
    slope = (
        follows * (slope[0] - stiffness * bend[0]),
        follows * (slope[1] - stiffness * bend[1]),
        follows * (slope[2] - stiffness * bend[2]),
    )
    return follows, shift, slope


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def turned(follows: Any, shift: Vector, before: Vector, direction: Vector) -> Any:
    """Rotation vector of an edge, and its direction by it.

    Args:
        before: rotation vector of the edge before.
    """
    theta = follows * before[0] - shift[0], follows * before[1] - shift[1], follows * before[2] - shift[2]
    return theta, rotated_by_gibbs((_HALF * theta[0], _HALF * theta[1], _HALF * theta[2]), direction)
