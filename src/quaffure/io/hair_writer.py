"""Strands of one frame in Cem Yuksel's `.hair`; `quaffure.io.hair` describes the format, and reads it.

Metres, z up, as the drape; thickness of every point [m] and one colour, linear RGB.
"""

from pathlib import Path

import numpy as np

from quaffure.hair.export_clip import HAIR_COLOUR, ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.hair import HEADER, POINTS, THICKNESS
from quaffure.io.output_path import check_one_frame, check_suffix

HAIR_SUFFIX = ".hair"
ABOUT = b"quaffure: metres, z up"


def write_hair(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame.

    Raises:
        InputError: another suffix than .hair, more than one frame, or not writable.
    """
    check_suffix(path, HAIR_SUFFIX)
    check_one_frame(path, len(clip.frames))
    strands = clip.strands(0)
    count, points = strands.shape[:2]
    width = clip.strand_width
    sizes = (count, count * points, POINTS | THICKNESS, points - 1)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(HEADER.pack(b"HAIR", *sizes, float(width[0]), 0.0, *HAIR_COLOUR, ABOUT))
        file.write(strands.astype("<f4").data)
        file.write(np.tile(width, count).astype("<f4").data)
