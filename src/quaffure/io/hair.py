"""Cem Yuksel's `.hair`: a 128-byte header, then the arrays that its flags announce (cemyuksel.com/research/hairmodels).

Little-endian. Header: "HAIR", u32 strands, u32 points, u32 flags, u32 default segments, f32 default thickness,
f32 default transparency, f32[3] default colour, char[88] free text. Arrays, in this order, where flagged:
u16 segments of each strand, f32[3] points, f32 thickness, f32 transparency, f32[3] colours of each point.
A strand of k segments has k + 1 points.
"""

import struct
from pathlib import Path

import numpy as np

from quaffure.errors import InputError
from quaffure.hair.strand_attributes import StrandAttributes
from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.binary import BinaryCursor

HEADER = struct.Struct("<4s4I5f88s")
SEGMENTS, POINTS, THICKNESS, TRANSPARENCY, COLOURS = 1, 2, 4, 8, 16
FIRST_RESERVED_FLAG = 32


def read_hair(path: Path) -> Strands:
    """Strands of a `.hair` file, in its own units and axes, with thickness and colour.

    Raises:
        InputError: not a `.hair` file, cut short, or its counts contradict each other or the file's size.
    """
    cursor = BinaryCursor(path)
    cursor.require(1, HEADER.size, "header")
    magic, strands, points, flags, default_segments, thickness, *_ = HEADER.unpack_from(cursor.content)
    cursor.offset = HEADER.size
    if magic != b"HAIR":
        raise InputError(path, "a .hair file, which begins with b'HAIR'", repr(magic))
    if not flags & POINTS:
        raise InputError(path, "a .hair file with a point array (flag 2)", f"flags {flags}")
    # With both, no count below can be larger than the file.
    cursor.require(3 * points, 4, f"{points} points")
    if strands > points:
        raise InputError(path, f"at least one point for each of its {strands} strands", f"{points} points")
    if flags & SEGMENTS:
        counts = cursor.array("<u2", strands, f"segments of {strands} strands").astype(np.int64) + 1
    else:
        counts = np.full(strands, default_segments + 1, dtype=np.int64)
    xyz = cursor.array("<f4", 3 * points, f"{points} points")
    more: dict[str, np.ndarray] = {}
    for flag, floats, what in (
        (THICKNESS, 1, "thicknesses"),
        (TRANSPARENCY, 1, "transparencies"),
        (COLOURS, 3, "colours"),
    ):
        if flags & flag:
            with np.errstate(invalid="ignore"):  # of signalling NaN
                more[what] = cursor.array("<f4", floats * points, what).astype(np.float64)
    if flags < FIRST_RESERVED_FLAG:  # a later version's arrays would follow
        cursor.finish()
    colours = more.get("colours")
    attributes = StrandAttributes(
        width=more.get("thicknesses", np.full(points, float(thickness)) if thickness > 0 else None),
        colour=None if colours is None else colours.reshape(-1, 3),
    )
    return checked_strands(xyz, counts, path, attributes=attributes)
