"""Two formats of i32 strands; then a strand: i32 points, and some f32 for each point. Little-endian.

USC-HairSalon's `.data` (Hu et al. 2015) has a point's position: metres, y up, around the database's own head. A strand
of one point is a bald root. CT2Hair's `.bin` (Shen et al. 2023) has its position in millimetres, its normal (f32[3])
and its label.
"""

from pathlib import Path

import numpy as np

from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.binary import BinaryCursor


def read_hairsalon(path: Path) -> Strands:
    """Strands of a `.data` file, in its own units and axes; bald roots are dropped.

    Raises:
        InputError: the file is cut short, goes on after its last strand, or holds no strand.
    """
    return _read_strands(path, 3)


def read_ct2hair(path: Path) -> Strands:
    """Strands of a `.bin` file, still in the file's millimetres and axes; normals and labels are not kept.

    Raises:
        InputError: the file is cut short, goes on after its last strand, or holds no strand.
    """
    return _read_strands(path, 7)


def _read_strands(path: Path, columns: int) -> Strands:
    cursor = BinaryCursor(path)
    # Without signs, so that a negative number is one that no file is long enough for.
    (strands,) = cursor.integers("<u4", 1, "number of strands")
    points = [np.empty(0, dtype=np.float32)]
    counts = []
    for strand in range(strands):
        (count,) = cursor.integers("<u4", 1, f"strand {strand} of {strands}")
        points.append(cursor.array("<f4", count * columns, f"strand {strand} of {strands}, of {count} points"))
        counts.append(count)
    cursor.finish()
    return checked_strands(np.concatenate(points).reshape(-1, columns)[:, :3], np.array(counts, dtype=np.int64), path)
