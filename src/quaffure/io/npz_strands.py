"""Strands as arrays of numpy: `.npy` of [S,N,3]; `.npz` with `strands` [S,N,3], or `points` [P,3] and `counts` [S].

An `.npz` may have `roots` [S,3], to which strands that begin at the origin are relative, as networks store them. NaN
after the tip fills rows of shorter strands. An `.npz` of one array [S,N,3] may have any name.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from quaffure.errors import InputError, refused
from quaffure.hair.strands import Strands, checked_strands
from quaffure.input_file import check_input_file
from quaffure.npz import array_headers, is_number, read_numbers

RELATIVE = 1e-6
"""Strands begin at the origin where all of their first points are closer to it, in sizes of the whole."""


def read_npz_strands(path: Path) -> Strands:
    """Strands of an `.npz` file, in its own units and axes. Pickled arrays are never loaded.

    Raises:
        InputError: not an `.npz`, damaged, or without arrays of the names and shapes above.
    """
    headers = array_headers(path)
    numeric = {name: header for name, header in headers.items() if is_number(header)}
    boxes = [name for name, header in numeric.items() if len(header.shape) == 3 and header.shape[2] == 3]
    box = "strands" if "strands" in numeric or len(boxes) != 1 else boxes[0]
    arrays = read_numbers(path, tuple(name for name in ("points", "counts", "roots", box) if name in numeric))
    if "points" in arrays and "counts" in arrays:
        points = _points(path, "array points", arrays["points"], 2)
        return checked_strands(points, _counts(path, arrays["counts"], len(points)), path)
    if box in arrays:
        return _from_box(arrays[box], arrays.get("roots"), path, f"array {box}")
    others = [
        f"{name} of type {headers[name].dtype} (not plain numbers, never loaded)"
        for name in headers
        if name not in numeric
    ]
    found = ", ".join([*numeric, *others]) or "no arrays"
    raise InputError(path, "arrays points and counts, or an array strands", found)


def read_npy_strands(path: Path) -> Strands:
    """Strands of an `.npy` file, in their own units and axes.

    Raises:
        InputError: not an `.npy`, cut short, or another kind of array.
    """
    expected = "an .npy file of strands [S,N,3]"
    check_input_file(path, expected)
    with refused(path, expected, Exception):
        # Mapped: no memory is taken for a size in the header that the file does not have.
        array = np.lib.format.open_memmap(path, mode="r")
    if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
        raise InputError(path, expected, f"numbers of type {array.dtype}")
    return _from_box(array, None, path, "array")


def _from_box(array: np.ndarray, roots: np.ndarray | None, path: Path, name: str) -> Strands:
    strands = _points(path, name, array, 3)
    if strands.shape[1] < 2:  # S x 0 points fit into any file, S counts may not fit into memory
        raise InputError(path, "at least 2 points a strand", str(strands.shape[1]))
    if roots is not None:
        strands = _at_roots(strands, roots, path)
    # NaN from a point on to the end of its row; one between points stays, and is refused.
    is_point = ~np.isnan(strands).any(axis=2)
    counts = np.where(is_point.any(axis=1), strands.shape[1] - np.argmax(is_point[:, ::-1], axis=1), 0)
    kept = np.arange(strands.shape[1]) < counts[:, None]
    return checked_strands(strands[kept], counts, path)


def _at_roots(strands: Float[np.ndarray, "s n 3"], roots: np.ndarray, path: Path) -> Float[np.ndarray, "s n 3"]:
    """Strands moved to their roots, unless they begin there already."""
    if roots.shape != (len(strands), 3) or not np.isfinite(roots).all():
        raise InputError(path, f"finite roots [{len(strands)}, 3]", f"shape {list(roots.shape)}, or NaN or infinity")
    size = float(np.abs(np.nan_to_num(strands)).max(initial=0.0))
    is_relative = float(np.abs(strands[:, 0]).max(initial=0.0)) <= RELATIVE * size
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite, or NaN, is refused by checked_strands
        return strands + roots[:, None].astype(np.float32) if is_relative else strands


def _points(path: Path, name: str, array: np.ndarray, dimensions: int) -> Float[np.ndarray, "... 3"]:
    if array.ndim != dimensions or array.shape[-1] != 3:
        axes = {2: "[P,3]", 3: "[S,N,3]"}[dimensions]
        frames = ", as the frames of a drape, which `quaffure render` draws" if array.ndim == 4 else ""
        raise InputError(path, f"{name} of shape {axes}", f"shape {list(array.shape)}{frames}")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, which checked_strands refuses
        return np.asarray(array).astype(np.float32)


def _counts(path: Path, counts: np.ndarray, points: int) -> Int[np.ndarray, " s"]:
    if counts.ndim != 1 or counts.dtype.kind not in "iu":
        raise InputError(path, "array counts of whole numbers, of shape [S]", f"{counts.dtype} {list(counts.shape)}")
    # Also keeps their sum from wrapping round, on which np.repeat ends the process.
    if len(counts) and (counts.min() < 0 or counts.max() > points):
        raise InputError(path, f"counts from 0 to {points}, its points", f"{counts.min()} to {counts.max()}")
    return counts.astype(np.int64)
