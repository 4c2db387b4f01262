"""Two formats of i32 strands; then a strand: i32 points, and some f32 for each point. Little-endian.

USC-HairSalon's `.data` (Hu et al. 2015) has a point's position: metres, y up, around the database's own head. A strand
of one point is a bald root. CT2Hair's `.bin` (Shen et al. 2023) has its position in millimetres, its normal (f32[3])
and its label.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int

from quaffure.hair.strand_attributes import NONE, StrandAttributes, groups_of
from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.binary import BinaryCursor


def read_hairsalon(path: Path) -> Strands:
    """Strands of a `.data` file, in its own units and axes; bald roots are dropped.

    Raises:
        InputError: the file is cut short, goes on after its last strand, or holds no strand.
    """
    rows, counts = _read_rows(path, 3)
    return checked_strands(rows, counts, path)


def read_ct2hair(path: Path) -> Strands:
    """Strands of a `.bin` file, still in the file's millimetres and axes, in groups by the label of their first point
    where there are several. Normals are not kept: they follow from the hair.

    Raises:
        InputError: the file is cut short, goes on after its last strand, or holds no strand.
    """
    rows, counts = _read_rows(path, 7)
    return checked_strands(rows[:, :3], counts, path, attributes=_groups(rows[:, 6], counts))


def _groups(labels: Float32[np.ndarray, " p"], counts: Int[np.ndarray, " s"]) -> StrandAttributes:
    first = (np.cumsum(counts) - counts)[counts > 0]
    if not np.isfinite(labels[first]).all() or len(np.unique(labels[first])) < 2:
        return NONE
    own = np.full(len(counts), labels[first[0]])  # strands without points are dropped
    own[counts > 0] = labels[first]
    return groups_of(own, None, len(counts), "label")


def _read_rows(path: Path, columns: int) -> tuple[Float32[np.ndarray, "p c"], Int[np.ndarray, " s"]]:
    """Numbers of every point, and points of every strand."""
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
    return np.concatenate(points).reshape(-1, columns), np.array(counts, dtype=np.int64)
