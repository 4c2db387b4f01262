"""The picture at the top of the README: `python scripts/figures/drapes.py DANCE.bvh`.

The shipped weights on six hairstyles: the neck turn of the paper's Fig. 6, then a dance clip, none trained on. The last
two styles were held out of all training.
"""

from pathlib import Path

import numpy as np
import torch
import tyro
from tiles import FIGURES, TileRenderer, View, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.body import bundled_clip, resample
from quaffure.io.read_motion import read_motion
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene

OUT = FIGURES / "drapes.jpg"
GROOMS = ("long_straight", "long_ringlets", "layered_shag", "ponytail", "side_part_lob", "mullet")
NECK_TURN, DANCE = [0, 22, 44, 66], [72, 90, 180, 252]
FPS = 30.0


def main(dance: tyro.conf.Positional[Path]) -> list[Path]:
    model = load_model()
    turn, danced = bundled_clip("neck_turn", model.body), resample(read_motion(dance, model.body), FPS)
    poses = torch.cat([turn.body_pose[NECK_TURN], danced.body_pose[DANCE]])
    bodies = BodyBatch(model.body, poses, torch.zeros(len(poses), 10))
    rows = []
    with TileRenderer(190, 230) as renderer:
        for name, colour in zip(GROOMS, NATURAL_COLOURS):
            scene = Scene(make_groom(name, model.body), bodies)
            rows.append(np.hstack(renderer.tiles(scene, model.draper.drape(scene), View(), colour)))
    save_picture(OUT, np.vstack(rows))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
