"""Strands of one frame in Cem Yuksel's `.hair`; `quaffure.io.hair` describes the format, and reads it.

Metres, z up, as the drape; thickness [m] and colour, linear RGB, of every point.
"""

from pathlib import Path

import numpy as np

from quaffure.errors import InputError
from quaffure.hair.export_clip import HAIR_COLOUR, ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.hair import COLOURS, HEADER, POINTS, SEGMENTS, THICKNESS
from quaffure.io.output_path import check_one_frame, check_suffix

HAIR_SUFFIX = ".hair"
MOST_SEGMENTS = 2**16 - 1
ABOUT = b"quaffure: metres, z up"


def write_hair(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame.

    Raises:
        InputError: another suffix than .hair, more than one frame, or not writable.
    """
    check_suffix(path, HAIR_SUFFIX)
    check_one_frame(path, len(clip.frames))
    counts, points, widths = clip.counts, clip.points(0), clip.widths
    of_all = int(counts[0]) - 1
    if counts.max() > MOST_SEGMENTS + 1:
        raise InputError(path, f"at most {MOST_SEGMENTS + 1} vertices a strand (--points)", f"{counts.max()}")
    same = bool((counts == counts[0]).all())
    arrays = POINTS | THICKNESS | COLOURS | (0 if same else SEGMENTS)
    with replacing(path) as temporary, temporary.open("wb") as file:
        sizes = (len(counts), len(points), arrays, of_all)
        file.write(HEADER.pack(b"HAIR", *sizes, float(widths[0]), 0.0, *HAIR_COLOUR, ABOUT))
        if not same:
            file.write((counts - 1).astype("<u2").data)
        for values in (points, widths, clip.colours):
            file.write(np.ascontiguousarray(values, "<f4").data)
