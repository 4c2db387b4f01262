"""bfloat16 in compiled kernels, which have no such type and handle its bits."""

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def rounded(word: np.uint32) -> np.uint32:
    """The bits of a float32 as those of the nearest bfloat16, ties to even."""
    return (word + np.uint32(0x7FFF) + ((word >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16)
