"""Fig. 5: one pose and one hairstyle on bodies that vary along the first two shape coefficients."""

from pathlib import Path

import torch
from tiles import (
    FIGURES,
    MOTION_FOLDER,
    Caption,
    TileRenderer,
    View,
    captioned,
    grid,
    load_scenes,
    run_figure,
    save_picture,
)

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.benchmark import CaseEntry, intersection_percent
from quaffure.model import load_model
from quaffure.scene import BodyBatch, Scene

OUT = FIGURES / "shapes.jpg"
POSE = CaseEntry("long_ringlets", "13_26", "a", (94,))
VARIED = (0, 1)
VALUES = (-2.5, -1.25, 0.0, 1.25, 2.5)  # standard deviations
VIEW = View(15.0, extent=0.80, below_head=0.16)


def main(motion_folder: Path = MOTION_FOLDER) -> list[Path]:
    model = load_model()
    (of_clip,) = load_scenes([POSE], motion_folder, model.body)
    rows = []
    with TileRenderer(260, 300) as renderer:
        for coefficient in VARIED:
            shapes = torch.zeros(len(VALUES), 10)
            shapes[:, coefficient] = torch.tensor(VALUES)
            bodies = BodyBatch(model.body, of_clip.bodies.body_pose.expand(len(VALUES), -1), shapes)
            scene = Scene(of_clip.groom, bodies)
            draped = model.draper.drape(scene)
            tiles = renderer.tiles(scene, draped, VIEW, NATURAL_COLOURS[1])
            inside = zip(intersection_percent(scene.posed, scene), intersection_percent(draped, scene))
            captions = [
                Caption(f"shape {coefficient + 1} = {value:g}", (f"{after:.2g} % inside (posed: {before:.2g} %)",))
                for value, (before, after) in zip(VALUES, inside)
            ]
            rows.append([captioned(tile, caption) for tile, caption in zip(tiles, captions)])
    save_picture(OUT, grid(rows))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
