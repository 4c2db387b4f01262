"""Hairstyles on an imported body, at rest and in a frame of a motion, from three sides: docs/figures/own_character.jpg.

    quaffure body import CHARACTER.glb --out my_body.npz
    python scripts/figures/own_character.py my_body.npz MOTION FRAME [GROOM.npz ...]

The network drapes bundled hairstyles and grooms of these files.
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


def main(body_file: str, motion: str, frame: str, *grooms: str) -> None:
    body = qf.load_body(body_file)
    draper = qf.load_model().on(body).draper
    pose = torch.stack([torch.zeros(81), load_motion(motion, body, in_place=True).body_pose[int(frame)]])
    rows = []
    for name in (*STYLES, *grooms):
        drape = qf.drape_clip(qf.load_groom(name, body), Motion(pose, 30.0, "two poses"), None, draper, body)
        tiles = [qf.draw(drape, index, view, TILE, body) for index in range(2) for view in VIEWS]
        rows.append(np.hstack([np.asarray(tile) for tile in tiles]))
    Image.fromarray(np.vstack(rows)).save(FIGURE, quality=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
