"""Digests of arrays and files."""

import hashlib
from pathlib import Path

import numpy as np
from torch import Tensor


def array_digest(*arrays: Tensor | np.ndarray) -> str:
    """Hexadecimal SHA-256 of the bytes of arrays, one after another."""
    sha = hashlib.sha256()
    for array in arrays:
        sha.update(np.ascontiguousarray(array.detach().cpu().numpy() if isinstance(array, Tensor) else array).data)
    return sha.hexdigest()


def file_digest(path: Path) -> str:
    """Hexadecimal SHA-256 of the bytes of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
