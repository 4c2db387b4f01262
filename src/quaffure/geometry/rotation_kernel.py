"""Rotations in compiled code, and a constant that kernels share with their torch twins."""

import math

import numpy as np
from numba import njit

from quaffure.geometry.mls_kernels import FAST

Vector = tuple[np.floating, np.floating, np.floating]

LEAST_ALIGNMENT = 0.1
"""Least 1 + cosine in a Gibbs vector, which has no end for opposite vectors."""


@njit(cache=True)
def write_rotation(axis_angle: np.ndarray, matrix: np.ndarray) -> None:
    """Fill the rotation matrix [3, 3] of an axis-angle vector [rad], in double precision (Rodrigues' formula)."""
    x, y, z = np.float64(axis_angle[0]), np.float64(axis_angle[1]), np.float64(axis_angle[2])
    squared = x * x + y * y + z * z
    sine, cosine = 1.0 - squared / 6.0, 0.5 - squared / 24.0  # sin a / a, (1 - cos a) / a^2
    if squared > 1e-6:
        angle = math.sqrt(squared)
        sine, cosine = math.sin(angle) / angle, 2.0 * math.sin(0.5 * angle) ** 2 / squared
    matrix[0, 0], matrix[1, 1], matrix[2, 2] = (
        1.0 - cosine * (y * y + z * z),
        1.0 - cosine * (x * x + z * z),
        1.0 - cosine * (x * x + y * y),
    )
    matrix[0, 1], matrix[1, 0] = cosine * x * y - sine * z, cosine * x * y + sine * z
    matrix[0, 2], matrix[2, 0] = cosine * x * z + sine * y, cosine * x * z - sine * y
    matrix[1, 2], matrix[2, 1] = cosine * y * z - sine * x, cosine * y * z + sine * x


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def rotated_by_gibbs(gibbs: Vector, vector: Vector) -> Vector:
    """A vector rotated by a Gibbs vector (Rodrigues 1840), in single precision. Kernels inline it."""
    (a, b, c), (x, y, z) = gibbs, vector
    scale = np.float32(2.0) / (np.float32(1.0) + a * a + b * b + c * c)
    u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
    return x + scale * (u + b * w - c * v), y + scale * (v + c * u - a * w), z + scale * (w + a * v - b * u)


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def pushed_edge(
    start: Vector, end: Vector, normal: Vector, push: float | np.floating, length: float | np.floating
) -> Vector:
    """The edge of a length from `start` towards `end` after a push of the end along a normal: the projection of
    position-based dynamics (Mueller et al. 2007) with lengths kept, in single precision. Kernels inline it.

    Args:
        start, end: positions [m].
        push: along the normal [m].
        length: of the result [m]; of 1, its direction.
    """
    x, y, z = (
        end[0] + push * normal[0] - start[0],
        end[1] + push * normal[1] - start[1],
        end[2] + push * normal[2] - start[2],
    )
    scale = length / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
    return scale * x, scale * y, scale * z


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def lifted_edge(
    edge: Vector, normal: Vector, push: float | np.floating, length: float | np.floating, most: float | np.floating
) -> Vector:
    """An edge of a length, rotated towards a normal until its end is higher by a push, or until the cosine between
    both is `most`; in single precision. Kernels inline it."""
    height = edge[0] * normal[0] + edge[1] * normal[1] + edge[2] * normal[2]
    x, y, z = edge[0] - height * normal[0], edge[1] - height * normal[1], edge[2] - height * normal[2]
    # An edge straight into the skin may leave it in any direction.
    if x * x + y * y + z * z < np.float32(1e-10) * length * length:
        if abs(normal[0]) < np.float32(0.7):
            x, y, z = np.float32(1.0) - normal[0] * normal[0], -normal[0] * normal[1], -normal[0] * normal[2]
        else:
            x, y, z = -normal[0] * normal[1], np.float32(1.0) - normal[1] * normal[1], -normal[1] * normal[2]
    cosine = min(max((height + push) / length, np.float32(-1.0)), most)
    scale = np.sqrt(max(np.float32(1.0) - cosine * cosine, np.float32(0.0)) / (x * x + y * y + z * z))
    return (
        length * (cosine * normal[0] + scale * x),
        length * (cosine * normal[1] + scale * y),
        length * (cosine * normal[2] + scale * z),
    )
