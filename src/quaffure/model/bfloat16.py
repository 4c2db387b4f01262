"""bfloat16 in compiled kernels: numpy and numba have no such type, so they read and write its bits."""

import numpy as np
import torch
from numba import njit

from quaffure.types import Tensor


def bits(values: Tensor) -> np.ndarray:
    """float32 or bfloat16 on the CPU as kernels take them: unsigned integers of the same size, in the same memory."""
    if values.itemsize == 2:
        return values.view(torch.int16).numpy().view(np.uint16)
    return values.numpy().view(np.uint32)


@njit(cache=True, inline="always")
def rounded(word: np.uint32) -> np.uint32:
    """The bits of a float32 as those of the nearest bfloat16, ties to even."""
    return (word + np.uint32(0x7FFF) + ((word >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16)
