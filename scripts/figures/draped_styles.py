"""The contact sheet of docs/hanging.md: `python scripts/figures/draped_styles.py`.

Every bundled style as it was designed, and by `strand_newton` with the neck turned and in a bow.
"""

from pathlib import Path

import numpy as np
import torch
from tiles import FIGURES, Caption, Picture, TileRenderer, View, at_rest, captioned, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.body import BodyModel, bundled_clip, load_body
from quaffure.procedural import STYLES, make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper

OUT = FIGURES / "draped_styles.jpg"
FRAMES = (("neck_turn", 36), ("bow", 60))
STYLES_PER_ROW = 4
DESIGN_VIEW, DRAPED_VIEW = View(azimuth_deg=30.0), View(azimuth_deg=30.0, extent=0.7)


def main() -> list[Path]:
    body = load_body()
    with TileRenderer(104, 136) as renderer:
        columns = [
            _style(renderer, name, NATURAL_COLOURS[index % len(NATURAL_COLOURS)], body)
            for index, name in enumerate(STYLES)
        ]
    rows = [np.hstack(columns[first : first + STYLES_PER_ROW]) for first in range(0, len(columns), STYLES_PER_ROW)]
    save_picture(OUT, np.vstack(rows))
    return [OUT]


def _style(renderer: TileRenderer, name: str, colour: tuple[float, float, float], body: BodyModel) -> Picture:
    """The design and its drapes side by side."""
    groom, shape = make_groom(name, body), torch.zeros(1, 10)
    tiles = renderer.tiles(at_rest(groom, body), groom.rest_strands[None], DESIGN_VIEW, colour)
    for clip, frame in FRAMES:
        scene = Scene(groom, BodyBatch(body, bundled_clip(clip, body).body_pose[frame : frame + 1], shape))
        tiles += renderer.tiles(scene, StrandNewtonDraper().drape(scene), DRAPED_VIEW, colour)
    return captioned(np.hstack(tiles), Caption(name))


if __name__ == "__main__":
    run_figure(main)
