"""Symmetric 3 x 3 matrices in compiled code, as the tuple 00, 10, 11, 20, 21, 22; inlined into kernels of any float."""

from typing import Any

import numpy as np
from numba import njit

Vector = tuple[Any, Any, Any]
Symmetric = tuple[Any, Any, Any, Any, Any, Any]
_ONE = np.float32(1.0)  # exact in float64 as well, and leaves float32 as it is


@njit(cache=True, inline="always")
def symmetric_times(m: Symmetric, v: Vector) -> Vector:
    """The matrix times a vector."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[3] * v[2],
        m[1] * v[0] + m[2] * v[1] + m[4] * v[2],
        m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
    )


@njit(cache=True, inline="always")
def symmetric_inverse(m: Symmetric, least: Any) -> Symmetric:
    """The inverse by L D L^T; rounding makes no pivot less than `least`."""
    i0 = _ONE / max(m[0], least)
    l10, l20 = m[1] * i0, m[3] * i0
    i1 = _ONE / max(m[2] - l10 * m[1], least)
    rest = m[4] - l20 * m[1]
    l21 = rest * i1
    i2 = _ONE / max(m[5] - l20 * m[3] - l21 * rest, least)
    n20 = l10 * l21 - l20
    return (
        i0 + l10 * l10 * i1 + n20 * n20 * i2,
        -l10 * i1 - l21 * n20 * i2,
        i1 + l21 * l21 * i2,
        n20 * i2,
        -l21 * i2,
        i2,
    )
