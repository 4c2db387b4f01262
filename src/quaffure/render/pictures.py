"""A drape as one still picture."""

from pathlib import Path

import numpy as np
from PIL import Image

from quaffure.errors import InputError
from quaffure.groom.drape_sequence import DrapeSequence
from quaffure.io.atomic import replacing
from quaffure.render.camera import Camera
from quaffure.render.framing import facing_deg, frame_hair
from quaffure.render.scene import CHESTNUT, StrandRenderer

VIEWS = (Camera.front, Camera.three_quarter, Camera.side, Camera.back)
TILE = 512
MOST_FRAMES = 4


def write_picture(
    path: Path, seq: DrapeSequence, hair_colour: tuple[float, float, float] = CHESTNUT, tile: int = TILE
) -> None:
    """Write a contact sheet (.png): up to four evenly spaced frames, one row each, from front to back of the head.

    Args:
        hair_colour: albedo in linear RGB.
        tile: width and height of one view [pixels].

    Raises:
        InputError: not a .png, not writable, or no OpenGL on this machine.
    """
    if path.suffix.lower() != ".png":
        raise InputError(path, "a picture's name ending in .png", f"{path.suffix or 'no suffix'}")
    centre, extent = frame_hair(seq)
    frames = np.unique(np.linspace(0, len(seq) - 1, min(MOST_FRAMES, len(seq))).round().astype(int))
    # Before the renderer: a folder that is missing should cost no drawing.
    with replacing(path) as temporary, StrandRenderer(tile, tile) as renderer:
        rows = [
            np.hstack(
                [
                    renderer.render(
                        seq.strands[f],
                        seq.body_vertices[f],
                        seq.body_faces,
                        view(centre, extent, facing_deg(seq, f)),
                        hair_colour,
                    )
                    for view in VIEWS
                ]
            )
            for f in frames
        ]
        Image.fromarray(np.vstack(rows)).save(temporary, format="PNG", compress_level=9)
