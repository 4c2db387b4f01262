"""The picture at the top of the README: `python scripts/figures/hanging.py DANCE.bvh`.

Six hairstyles by `strand_newton`: upright, in a dance (CMU 05_04, frame 90), in a bow (frame 60); front and side. Each
clip is draped from 30 frames before.
"""

from pathlib import Path

import numpy as np
import torch
import tyro
from tiles import FIGURES, Picture, TileRenderer, View, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.body import BodyModel, bundled_clip, load_body, resample
from quaffure.hair import Groom
from quaffure.io.read_motion import read_motion
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper
from quaffure.types import BodyPose, Positions

OUT = FIGURES / "hanging.jpg"
GROOMS = ("long_straight", "bob", "long_ringlets", "layered_shag", "ponytail", "afro")
DANCE, BOW, BEFORE = 90, 60, 30
FPS = 30.0
VIEWS = (View(), View(azimuth_deg=90.0))


def main(dance: tyro.conf.Positional[Path]) -> list[Path]:
    body = load_body()
    danced = resample(read_motion(dance, body), FPS).body_pose
    clips = [torch.zeros(1, 81)]
    clips += [
        clip[end - BEFORE : end + 1] for clip, end in ((danced, DANCE), (bundled_clip("bow", body).body_pose, BOW))
    ]
    with TileRenderer(190, 250) as renderer:
        rows = [
            np.hstack([tile for clip in clips for tile in _tiles(renderer, make_groom(name, body), body, clip, colour)])
            for name, colour in zip(GROOMS, NATURAL_COLOURS)
        ]
    save_picture(OUT, np.vstack(rows))
    return [OUT]


def _tiles(
    renderer: TileRenderer, groom: Groom, body: BodyModel, clip: BodyPose, colour: tuple[float, float, float]
) -> list[Picture]:
    """The last frame of a clip, from every view."""
    scene, draped = _last_frame(groom, body, clip)
    return [tile for view in VIEWS for tile in renderer.tiles(scene, draped, view, colour)]


def _last_frame(groom: Groom, body: BodyModel, clip: BodyPose) -> tuple[Scene, Positions]:
    draper = CoherentDraper()
    for body_pose in clip.split(1):
        scene = Scene(groom, BodyBatch(body, body_pose, torch.zeros(1, 10)))
        draped = draper.drape(scene)
    return scene, draped


if __name__ == "__main__":
    run_figure(main)
