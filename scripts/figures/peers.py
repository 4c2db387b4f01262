"""Where the programs of benchmarks/peers leave the same hundred strands, side by side.

Draws what `python benchmarks/peers/compare.py --out docs/peers.json` left in its folder. Strands are drawn as they are,
none between them.
"""

import json
from pathlib import Path

import numpy as np
import torch
from tiles import FIGURES, Caption, View, captioned, grid, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS, StrandRenderer
from quaffure.body import bundled_clip, load_body
from quaffure.scene import BodyBatch

OUT = FIGURES / "peers.jpg"
RESULTS = FIGURES.parent / "peers.json"
TILES = {
    "ours_posed": "posed",
    "ours_neural": "neural",
    "ours_xpbd": "xpbd",
    "ours_lbfgs": "lbfgs",
    "ours_lbfgs_cosserat": "lbfgs, cosserat",
    "dismech_100": "dismech-newton",
    "mujoco_100": "MuJoCo",
}
VIEWS = (View(40.0, 0.42, 0.04), View(-150.0, 0.42, 0.04))
STRAND_WIDTH = 1.5e-3  # m


def main(folder: Path = Path("runs/peers")) -> list[Path]:
    body = load_body()
    _, motion, frame = json.loads(RESULTS.read_text())["scene"]
    bodies = BodyBatch(body, bundled_clip(motion, body).body_pose[frame : frame + 1], torch.zeros(1, 10))
    skin, faces = bodies.posed.vertices[0].numpy(), body.faces.numpy()
    tiles = []
    with StrandRenderer(170, 200, supersampling=3, strand_width=STRAND_WIDTH) as renderer:
        for name, title in TILES.items():
            with np.load(folder / f"{name}.npz", allow_pickle=False) as file:
                strands = file["positions"][-1]
            cameras = [view.camera(bodies, 0) for view in VIEWS]
            views = [renderer.render(strands, skin, faces, camera, NATURAL_COLOURS[1]) for camera in cameras]
            tiles.append(captioned(np.vstack(views), Caption(title)))
    save_picture(OUT, grid([tiles]), 150_000)
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
