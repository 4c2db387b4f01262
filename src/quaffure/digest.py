"""Digests of arrays."""

import hashlib

import numpy as np
from torch import Tensor


def array_digest(*arrays: Tensor | np.ndarray) -> str:
    """Hexadecimal SHA-256 of the bytes of arrays, one after another."""
    sha = hashlib.sha256()
    for array in arrays:
        sha.update(np.ascontiguousarray(array.detach().cpu().numpy() if isinstance(array, Tensor) else array).data)
    return sha.hexdigest()
