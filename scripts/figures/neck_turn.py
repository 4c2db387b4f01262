"""Fig. 6: the neck turns from right to left; a strip, how much the hair jitters from frame to frame, and a video.

The jitter at a frame is the mean acceleration of the hair's vertices relative to the head (`docs/metrics.md`),
here in millimetres per frame squared and not over a solver's. Needs the extra `docs` (matplotlib).
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tiles import FIGURES, Caption, Picture, TileRenderer, View, captioned, grid, run_figure, save_picture
from torch import Tensor

from quaffure.apps.render import NATURAL_COLOURS, encode_video
from quaffure.baselines import PosedDraper
from quaffure.benchmark import accelerations, vertices_from_head
from quaffure.body import BodyModel, Motion, bundled_clip
from quaffure.drape_motion import drape_motion
from quaffure.draper import Draper
from quaffure.hair import Groom
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers.strand_newton import with_settling
from quaffure.types import Positions

STRIP, VIDEO = FIGURES / "neck_turn.jpg", FIGURES / "neck_turn.mp4"
GROOMS = ("long_straight", "long_ringlets")
FROM_RIGHT_TO_LEFT = "0:61"
SHOWN = range(0, 61, 12)
VIEW = View(0.0)
DPI, PLOT_HEIGHT = 100, 260
CONSTANT_RATE_FACTOR = 24


def main() -> list[Path]:
    model = load_model()
    turn = bundled_clip("neck_turn", model.body).frames(FROM_RIGHT_TO_LEFT)
    bodies = BodyBatch(model.body, turn.body_pose, torch.zeros(len(turn), 10))
    drapers = (PosedDraper(), model.draper, with_settling(model.draper))
    films, jitter = [], {}
    with TileRenderer(240, 280, strands=6_000, supersampling=2) as renderer:
        for name, colour in zip(GROOMS, NATURAL_COLOURS):
            groom = make_groom(name, model.body)
            drapes = {draper.name: _drape(draper, groom, turn, model.body) for draper in drapers}
            films.append(renderer.tiles(Scene(groom, bodies), drapes[model.draper.name], VIEW, colour))
            jitter[name] = {row: 1000 * accelerations(vertices_from_head(hair, bodies)) for row, hair in drapes.items()}
            print(name, *(f"{row}: mean {of.mean():.3f}, most {of.max():.3f}" for row, of in jitter[name].items()))
    strip = grid([[captioned(film[i], Caption(f"frame {i}")) for i in SHOWN] for film in films])
    save_picture(STRIP, np.vstack([strip, _plot(jitter, strip.shape[1])]))
    there = [np.hstack(pair) for pair in zip(*films)]
    # The clip turns back through the same poses, and hair at rest knows no direction.
    encode_video(VIDEO, there + there[-2:0:-1], turn.fps, CONSTANT_RATE_FACTOR)
    return [STRIP, VIDEO]


def _drape(draper: Draper, groom: Groom, turn: Motion, body: BodyModel) -> Positions:
    return torch.from_numpy(drape_motion(draper, groom, body, turn, torch.zeros(10)).strands)


def _plot(jitter: dict[str, dict[str, Float[Tensor, " f"]]], width: int) -> Picture:
    """Jitter over frames, a panel a groom [mm per frame^2]."""
    figure = Figure(figsize=(width / DPI, PLOT_HEIGHT / DPI), dpi=DPI, layout="constrained")
    panels = figure.subplots(1, len(jitter), sharey=True)
    for panel, (name, rows) in zip(panels, jitter.items()):
        for row, values in rows.items():
            panel.plot(np.arange(1, len(values) + 1), values, label=row)
        panel.set_title(name.replace("_", " "), fontsize="medium")
        panel.set_xlabel("frame")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("acceleration from the head\n[mm per frame²]")
    panels[0].legend(fontsize="small")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


if __name__ == "__main__":
    run_figure(main)
