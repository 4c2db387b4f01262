"""Fig. 11: one hairstyle with k_Cosserat from stiff to soft, settled by Adam on directions.

The network has one material, the package's default, so a solver stands in for it.
"""

from pathlib import Path

import numpy as np
import torch
from tiles import FIGURES, Caption, TileRenderer, View, captioned, grid, run_figure, save_picture

from quaffure.apps.render.contact_sheet import NATURAL_COLOURS
from quaffure.body.body_model import load_body
from quaffure.config import HairMaterial
from quaffure.procedural.generator import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers.adam import AdamDraper

OUT = FIGURES / "stiffness.jpg"
GROOM = "long_ringlets"
STIFFNESS = (2e-6, 6e-7, 2e-7, 6e-8, 2e-8)  # [J]
VIEWS = (View(40.0, below_head=0.12), View(180.0, below_head=0.12))


def main() -> list[Path]:
    body = load_body()
    scene = Scene(make_groom(GROOM, body), BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))
    columns = {"as designed": scene.posed}
    for k in STIFFNESS:
        columns[f"k_Cosserat = {k:g} J"] = AdamDraper(HairMaterial(k_cosserat=k)).drape(scene)
    tiles = []
    with TileRenderer(240, 270) as renderer:
        for title, hair in columns.items():
            lower = 100 * float((scene.posed - hair)[:, :, -1, 2].mean())
            views = [renderer.tiles(scene, hair, view, NATURAL_COLOURS[2])[0] for view in VIEWS]
            tiles.append(captioned(np.vstack(views), Caption(title, (f"tips {lower:.1f} cm lower",))))
    save_picture(OUT, grid([tiles]))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
