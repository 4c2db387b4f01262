"""Strands of an OpenUSD file, which a process of its own reads (`quaffure.io.usd_curves`)."""

from pathlib import Path

from quaffure.hair.strands import Strands
from quaffure.io.strand_process import read_in_process

PREFIX = "quaffure:"
"""Prefix of the primvars of held parts."""


def read_usd_strands(path: str | Path) -> Strands:
    """All curves of a stage in world space, at each one's first time sample; the file's units and up axis are kept.

    Cubic bases and NURBS are evaluated, instances are read, and hidden curves, proxies and guides, by their purpose or
    by Unreal's primvar `groom_guide`, are left out where there are others. Pinned Catmull-Rom curves with held parts,
    as `write_usd` writes, are read as polylines through their points.

    Raises:
        InputError: the USD library is not installed; not a USD file, one that takes more time or memory than its size
            accounts for, or no curves in it.
    """
    path = Path(path)
    return read_in_process("quaffure.io.usd_curves", path, "usd", "a USD file")
