"""Strands in numpy's `.npz`: `points` [P,3] with `counts` [S] for strands of any length, or `strands` [S,N,3]."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from quaffure.errors import InputError
from quaffure.hair.strands import Strands, checked_strands
from quaffure.npz import read_numbers


def read_npz_strands(path: Path) -> Strands:
    """Strands of an `.npz` file, in its own units and axes. Pickled arrays are refused, and never loaded.

    Raises:
        InputError: not an `.npz`, damaged, or without arrays of the names and shapes above.
    """
    arrays = read_numbers(path, ("points", "counts", "strands"))
    if "points" in arrays and "counts" in arrays:
        points = _points(path, "points", arrays["points"], 2)
        counts = _counts(path, arrays["counts"], len(points))
    elif "strands" in arrays:
        strands = _points(path, "strands", arrays["strands"], 3)
        if strands.shape[1] < 2:  # S x 0 points fit into any file, S counts may not fit into memory
            raise InputError(path, "at least 2 points a strand", str(strands.shape[1]))
        points, counts = strands.reshape(-1, 3), np.full(strands.shape[0], strands.shape[1], dtype=np.int64)
    else:
        raise InputError(path, "arrays points and counts, or an array strands", ", ".join(arrays) or "none of them")
    return checked_strands(points, counts, path)


def _points(path: Path, name: str, array: np.ndarray, dimensions: int) -> Float[np.ndarray, "... 3"]:
    if array.ndim != dimensions or array.shape[-1] != 3:
        axes = {2: "[P,3]", 3: "[S,N,3]"}[dimensions]
        raise InputError(path, f"array {name} of shape {axes}", f"shape {list(array.shape)}")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which checked_strands refuses
        return array.astype(np.float32)


def _counts(path: Path, counts: np.ndarray, points: int) -> Int[np.ndarray, " s"]:
    if counts.ndim != 1 or counts.dtype.kind not in "iu":
        raise InputError(path, "array counts of whole numbers, of shape [S]", f"{counts.dtype} {list(counts.shape)}")
    # Also keeps their sum from wrapping round, on which np.repeat ends the process.
    if len(counts) and (counts.min() < 0 or counts.max() > points):
        raise InputError(path, f"counts from 0 to {points}, its points", f"{counts.min()} to {counts.max()}")
    return counts.astype(np.int64)
