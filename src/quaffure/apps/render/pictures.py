"""A drape as one still picture."""

from pathlib import Path

import numpy as np
from PIL import Image

from quaffure.apps.render.camera import Camera
from quaffure.apps.render.framing import drawn_strands, facing_deg, frame_hair
from quaffure.apps.render.scene import CHESTNUT, StrandRenderer
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.io.atomic import replacing

VIEWS = (Camera.front, Camera.three_quarter, Camera.side, Camera.back)
TILE = 512
MOST_FRAMES = 4


def write_picture(
    path: Path,
    seq: DrapeSequence,
    hair_colour: tuple[float, float, float] = CHESTNUT,
    tile: int = TILE,
    interpolation: GuideInterpolation | None = None,
) -> None:
    """Write a contact sheet (.png): up to four evenly spaced frames, one row each, from front to back of the head.

    Args:
        hair_colour: albedo in linear RGB.
        tile: width and height of one view [pixels].
        interpolation: of strands between the drape's guides; without it the guides themselves are drawn.

    Raises:
        InputError: not a .png, not writable, or no OpenGL on this machine.
    """
    if path.suffix.lower() != ".png":
        raise InputError(path, "a picture's name ending in .png", f"{path.suffix or 'no suffix'}")
    centre, extent = frame_hair(seq)
    frames = np.unique(np.linspace(0, len(seq) - 1, min(MOST_FRAMES, len(seq))).round().astype(int))
    # Before the renderer: a folder that is missing should cost no drawing.
    with replacing(path) as temporary, StrandRenderer(tile, tile) as renderer:
        rows = []
        for f in frames:
            strands, vertices = drawn_strands(seq, f, interpolation), seq.body_vertices[f]
            cameras = [view(centre, extent, facing_deg(seq, f)) for view in VIEWS]
            rows.append([renderer.render(strands, vertices, seq.body_faces, c, hair_colour) for c in cameras])
        Image.fromarray(np.vstack([np.hstack(row) for row in rows])).save(temporary, format="PNG", compress_level=9)
