"""The picture at the top of the README: `python scripts/readme_picture.py`.

The shipped weights on a bundled groom and the neck turn of the paper's Fig. 6, as a compressed strip.
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from quaffure.body.body_model import load_body
from quaffure.body.clips import bundled_clip
from quaffure.drapers.drape_motion import drape_motion
from quaffure.drapers.quaffure_model import load_model
from quaffure.groom.procedural import make_groom
from quaffure.render.camera import Camera
from quaffure.render.framing import frame_hair
from quaffure.render.scene import StrandRenderer

OUT = Path(__file__).parents[1] / "docs" / "figures" / "neck_turn.jpg"
TILE = 360
FRAMES = (0, 20, 40, 60, 80)


def main() -> None:
    body = load_body()
    motion = bundled_clip("neck_turn", body)
    chosen = type(motion)(motion.body_pose[list(FRAMES)], motion.fps, motion.name)
    drape = drape_motion(load_model().draper, make_groom("long_straight", body), body, chosen, torch.zeros(10))
    centre, extent = frame_hair(drape)
    with StrandRenderer(TILE, TILE) as renderer:
        tiles = [
            renderer.render(drape.strands[f], drape.body_vertices[f], drape.body_faces, Camera.front(centre, extent))
            for f in range(len(drape))
        ]
    Image.fromarray(np.hstack(tiles)).save(OUT, quality=85, optimize=True)


if __name__ == "__main__":
    main()
