"""Strands of an Alembic file, which a process of its own reads (`quaffure.io.alembic_curves`)."""

from pathlib import Path

from quaffure.hair.strands import Strands
from quaffure.input_file import check_start
from quaffure.io.strand_process import read_in_process

EXPECTED = "an Alembic file"
STARTS = (b"Ogawa", b"\x89HDF")
"""First bytes of Alembic's two containers."""


def read_alembic_strands(path: Path) -> Strands:
    """All curves of an archive in its world, at each one's first sample; the file's units and axes are kept.

    Cubic bases and NURBS are evaluated; hidden curves, and guides by Unreal's attribute `groom_guide`, are left out
    where there are others.

    Raises:
        InputError: the Alembic library is not installed; not an Alembic file, one that takes more time or memory than
            its size accounts for, or no curves in it.
    """
    check_start(path, STARTS, EXPECTED)
    return read_in_process("quaffure.io.alembic_curves", path, "alembic", EXPECTED)
