"""AMD TressFX's `.tfx`, versions 3 and 4: a header, then strands of one length at the offset that it names.

Little-endian. Both begin with f32 version, u32 strands n, u32 points of a strand k.
Version 4 goes on with u32[5] offsets (positions first), u32[32] reserved: 160 bytes. Positions are f32[4]; w = 0 pins.
Version 3 goes on with u32 follow hairs, i32 both ends pinned, u32[31] reserved, u32[6] offsets (positions first, at
byte 144), u32[32] reserved: 296 bytes. Positions are f32[3].
Pins and follow hairs belong to TressFX's own simulation and are not kept: a drape pins the root and nothing else.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quaffure.errors import InputError
from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.binary import BinaryCursor


@dataclass(frozen=True)
class Layout:
    """Where one version keeps what the reader needs [bytes]; `columns` is the floats of a position."""

    header: int
    position_offset: int
    columns: int


LAYOUTS = {3: Layout(296, 144, 3), 4: Layout(160, 12, 4)}


def read_tressfx(path: Path) -> Strands:
    """Strands of a `.tfx` file, in its own units and axes.

    Raises:
        InputError: neither version 3 nor 4, cut short, or with sizes or offsets that cannot be.
    """
    cursor = BinaryCursor(path)
    layout = _layout(cursor)
    cursor.require(layout.header - cursor.offset, 1, "header")
    strands, count = cursor.integers("<u4", 2, "header")
    # Also keeps n x 0 points, which fit into any file, from being allocated as n counts.
    if count < 2:
        raise InputError(path, "at least 2 points a strand", str(count))
    cursor.offset = layout.position_offset
    (offset,) = cursor.integers("<u4", 1, "header")
    if offset < layout.header:
        raise InputError(path, f"positions after the header, from byte {layout.header} on", f"their offset {offset}")
    # Bytes between, before and after the blocks that the offsets name are allowed: no finish() here.
    cursor.offset = offset
    points = cursor.array("<f4", strands * count * layout.columns, f"{strands} strands of {count} points")
    return checked_strands(points.reshape(-1, layout.columns)[:, :3], np.full(strands, count), path)


def _layout(cursor: BinaryCursor) -> Layout:
    version = float(cursor.array("<f4", 1, "version")[0])
    for major, layout in LAYOUTS.items():
        if major <= version < major + 1:
            return layout
    raise InputError(cursor.path, "a .tfx file of TressFX version 3 or 4", f"version {version:g}")
