"""Strands of one frame in Stanford's PLY: vertices, the edges between them, and what belongs to a strand as a whole.

Metres, z up, as the drape. Each vertex has the index of its strand, its width [m] and its colour: sRGB of 8 bits, which
viewers show, and where the source of the strands has colours these as linear RGB of 32 bits. The element `strand`
follows after those that viewers read: segments, id, group and texture coordinates of the root.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from quaffure.hair.export_clip import ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_one_frame, check_suffix

PLY_SUFFIX = ".ply"
COLOUR, LINEAR_COLOUR = ("red", "green", "blue"), ("linear_red", "linear_green", "linear_blue")
TYPES = {"<f4": "float", "<i4": "int", "|u1": "uchar"}


def write_ply(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame.

    Raises:
        InputError: another suffix than .ply, more than one frame, or not writable.
    """
    check_suffix(path, PLY_SUFFIX)
    check_one_frame(path, len(clip.frames))
    counts = clip.counts
    is_last = np.zeros(int(counts.sum()), bool)
    is_last[np.cumsum(counts) - 1] = True
    first = np.flatnonzero(~is_last).astype("<i4")
    elements = {
        "vertex": _table(_vertices(clip)),
        "edge": _table({"vertex1": first, "vertex2": first + np.int32(1)}),
        "strand": _table(_strands(clip)),
    }
    lines = ["ply", "format binary_little_endian 1.0", f"comment {len(counts)} strands from root to tip, metres, z up"]
    for group, name in enumerate(clip.group_names if clip.has_groups else ()):
        lines.append(f"comment group {group} {name.encode('ascii', 'replace').decode()!r}")
    for name, table in elements.items():
        lines.append(f"element {name} {len(table)}")
        lines += [f"property {TYPES[table.dtype[column].str]} {column}" for column in table.dtype.names or ()]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join([*lines, "end_header\n"]).encode("ascii"))
        for table in elements.values():
            file.write(table.data)


def _vertices(clip: ExportClip) -> dict[str, np.ndarray]:
    columns = dict(zip("xyz", clip.points(0).T))
    columns["strand"] = np.repeat(np.arange(clip.strand_count, dtype="<i4"), clip.counts)
    columns["width"] = clip.widths
    columns |= dict(zip(COLOUR, srgb_of(clip.colours).T))
    return columns | (dict(zip(LINEAR_COLOUR, clip.colours.T)) if clip.has_colours else {})


def _strands(clip: ExportClip) -> dict[str, np.ndarray]:
    columns = {"nsegs": clip.counts - np.int32(1)}
    if clip.identifiers is not None:
        columns["id"] = clip.identifiers
    if clip.has_groups:
        columns["group"] = clip.groups
    return columns | ({} if clip.root_uv is None else dict(zip("st", clip.root_uv.T)))


def _table(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Rows of an element."""
    table = np.empty(
        len(next(iter(columns.values()))), [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    )
    for name, values in columns.items():
        table[name] = values
    return table


def srgb_of(colour: Float[np.ndarray, "p 3"]) -> UInt8[np.ndarray, "p 3"]:
    """sRGB of 8 bits of linear RGB (IEC 61966-2-1)."""
    linear = colour.clip(0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def linear_of(srgb: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    """Linear RGB of sRGB from 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
