"""Strands of an Alembic file, which a process of its own reads (`quaffure.io.alembic_curves`)."""

from pathlib import Path

from quaffure.hair.strands import Strands
from quaffure.input_file import check_start
from quaffure.io.strand_process import read_in_process

EXPECTED = "an Alembic file"
STARTS = (b"Ogawa", b"\x89HDF")
"""First bytes of Alembic's two containers."""
TOOL_PROPERTY, WRITER = "groom_tool", "quaffure"
"""Property of the topmost node of a groom, the name and version of the program that wrote it; and the name of this one,
which every version has written there."""


def read_alembic_strands(path: Path) -> Strands:
    """All curves of an archive in its world, at each one's first sample; the file's units and axes are kept.

    A groom that this package wrote, by `TOOL_PROPERTY`, is in the left-handed axes of Unreal. Its y is negated: it is
    read in the right-handed axes of the drape, z up, in centimetres. A drape in the scene of a character has the axes
    of that file, y up turned to z up.

    Cubic bases and NURBS are evaluated; hidden curves, and guides by Unreal's attribute `groom_guide`, are left out
    where there are others.

    Raises:
        InputError: the Alembic library is not installed; not an Alembic file, one that takes more time or memory than
            its size accounts for, or no curves in it.
    """
    check_start(path, STARTS, EXPECTED)
    return read_in_process("quaffure.io.alembic_curves", path, "alembic", EXPECTED)
