"""Hairstyles on an imported body, at rest and in a frame of a motion, from three sides: docs/figures/own_character.jpg.

    quaffure body import CHARACTER.glb --out my_body.npz
    python scripts/figures/own_character.py my_body.npz MOTION FRAME [GROOM.npz ...]

Bundled hairstyles and grooms of these files, draped as `quaffure drape` does: hair follows from a second before FRAME.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import quaffure as qf
from quaffure.body import Motion
from quaffure.io.load_motion import load_motion

FIGURE = Path(__file__).parents[2] / "docs/figures/own_character.jpg"
STYLES, VIEWS, TILE = ("bob", "long_wavy", "ponytail"), ("front", "side", "back"), 230
FPS = 30


def main(body_file: str, motion: str, frame: str, *grooms: str) -> None:
    body = qf.load_body(body_file)
    clip = load_motion(motion, body, in_place=True).frames(f"{int(frame) - FPS}:{int(frame) + 1}")
    rest = Motion(torch.zeros(1, 81), FPS, "rest")
    rows = []
    for name in (*STYLES, *grooms):
        groom = qf.load_groom(name, body)
        drapes = [qf.drape_clip(groom, poses, body=body) for poses in (rest, clip)]
        tiles = [qf.draw(drape, -1, view, TILE, body) for drape in drapes for view in VIEWS]
        rows.append(np.hstack([np.asarray(tile) for tile in tiles]))
    Image.fromarray(np.vstack(rows)).save(FIGURE, quality=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
