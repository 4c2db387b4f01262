"""USC-HairSalon's `.data` (Hu et al. 2015): i32 strands; then a strand: i32 points, f32[3] each. Little-endian.

Metres, y up, around the database's own head. A strand of one point is a bald root.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from quaffure.errors import InputError
from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.binary import BinaryCursor


def read_hairsalon(path: Path) -> Strands:
    """Strands of a `.data` file, in its own units and axes; bald roots are dropped.

    Raises:
        InputError: the file is cut short, goes on after its last strand, or holds no strand.
    """
    points, counts = read_counted_strands(path, 3)
    return checked_strands(points, counts, path)


def read_counted_strands(path: Path, columns: int) -> tuple[Float[np.ndarray, "p columns"], Int[np.ndarray, " s"]]:
    """The layout that `.data` and CT2Hair's `.bin` share, with `columns` floats for each point.

    Returns:
        All points, and the points of each strand.

    Raises:
        InputError: a count is negative or too large for the file, or bytes are left over.
    """
    cursor = BinaryCursor(path)
    (strands,) = cursor.integers("<i4", 1, "number of strands")
    _check_count(path, strands, "strands")
    points = [np.empty(0, dtype=np.float32)]
    counts = []
    for strand in range(strands):
        (count,) = cursor.integers("<i4", 1, f"strand {strand} of {strands}")
        _check_count(path, count, f"points in strand {strand}")
        points.append(cursor.array("<f4", count * columns, f"strand {strand} of {strands}, of {count} points"))
        counts.append(count)
    cursor.finish()
    return np.concatenate(points).reshape(-1, columns), np.array(counts, dtype=np.int64)


def _check_count(path: Path, count: int, what: str) -> None:
    if count < 0:
        raise InputError(path, f"a number of {what} of at least 0", str(count))
