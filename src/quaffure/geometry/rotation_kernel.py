"""A rotation matrix in compiled code, and a constant that kernels share with their torch twins."""

import math

import numpy as np
from numba import njit

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
