"""The smoothing kernel of the density, Eq. 13: in torch, and as scalar functions that every kernel inlines.

The constants are float32 numbers that float64 holds exactly too: the precision is that of the argument.
"""

import math

import numpy as np
import torch
from numba import njit

from quaffure.types import Float, Tensor

_ZERO, _ONE, _TWO, _THREE, _FOUR = (np.float32(number) for number in range(5))


def smoothing_kernel(distance: Float[Tensor, "*n"], smoothing_length: float) -> Float[Tensor, "*n"]:
    """Eq. 13, W(r, h) as printed (Bando et al. 2003): dimensionless, 4 at r = 0, zero from 2h on, C2 at h and 2h."""
    q = distance / smoothing_length
    near = 4 - 6 * q.square() + 3 * q.pow(3)
    far = (2 - q).clamp(min=0).pow(3)
    return torch.where(q < 1, near, far)


def kernel_volume(smoothing_length: float) -> float:
    """Integral of Eq. 13 over space, 4 pi h^3 [m^3]: dividing by it turns masses into a density."""
    return 4 * math.pi * smoothing_length**3


@njit(cache=True, fastmath=True, inline="always")
def kernel_value(q: float) -> float:
    """Eq. 13, W at q = r / h, without a branch."""
    far, near = max(_TWO - q, _ZERO), max(_ONE - q, _ZERO)
    return far * far * far - _FOUR * near * near * near


@njit(cache=True, fastmath=True, inline="always")
def kernel_slope(q: float) -> float:
    """dW / dq of Eq. 13 at q = r / h, without a branch."""
    far, near = max(_TWO - q, _ZERO), max(_ONE - q, _ZERO)
    return _THREE * (_FOUR * near * near - far * far)


@njit(cache=True, fastmath=True, inline="always")
def per_kernel_volume(smoothing_length: np.float32) -> np.float32:
    """1 over `kernel_volume` [1/m^3], in single precision. Kernels inline it."""
    return np.float32(1.0 / (4.0 * math.pi)) / (smoothing_length * smoothing_length * smoothing_length)
