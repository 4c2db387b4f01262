"""CT2Hair's `.bin` (Shen et al. 2023): i32 strands; then a strand: i32 points, f32[7] each. Little-endian.

A point is its position, its normal and its label. Positions are in millimetres.
"""

from pathlib import Path

from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.hairsalon import read_counted_strands


def read_ct2hair(path: Path) -> Strands:
    """Strands of a `.bin` file, still in the file's millimetres and axes; normals and labels are not kept.

    Raises:
        InputError: the file is cut short, goes on after its last strand, or holds no strand.
    """
    points, counts = read_counted_strands(path, 7)
    return checked_strands(points[:, :3], counts, path)
