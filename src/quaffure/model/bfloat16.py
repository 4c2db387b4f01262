"""bfloat16 in compiled kernels, which have no such type and handle its bits."""

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def rounded(word: np.uint32) -> np.uint32:
    """The bits of a float32 as those of the nearest bfloat16, ties to even."""
    return (word + np.uint32(0x7FFF) + ((word >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16)


@njit(cache=True, inline="always")
def stored(word: np.uint32, itemsize: int) -> np.uint32:
    """The bits of a float32 as they are stored in numbers of 4 bytes, or of 2 as a bfloat16."""
    return word if itemsize == 4 else rounded(word)
