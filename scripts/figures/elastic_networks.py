"""Fig. 10 by networks: one trained with each elastic model on curly hair, and how fast the three trainings converge.

Trains what `runs_folder` does not hold yet, all with the same samples, and continues stopped runs; then draws.
"""

from pathlib import Path

import torch
from elastic_models import VIEWS, what_is_kept
from short_training import GROOM, train_shortly
from tiles import FIGURES, Caption, TileRenderer, grid, run_figure, save_picture
from training_curves import plot_curves, read_curve

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.benchmark import intersection_percent
from quaffure.body import bundled_clip, load_body
from quaffure.energies import ELASTIC_MODELS
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Positions

PICTURE, PLOT = FIGURES / "elastic_networks.jpg", FIGURES / "elastic_training.png"
TURNED = ("neck_turn", 30)  # a clip, and a frame of it


def main(runs_folder: Path = Path("runs/elastic")) -> list[Path]:
    runs = {name: runs_folder / name for name in ELASTIC_MODELS}
    for name, folder in runs.items():
        train_shortly(folder, ("--elastic", name))
    _draw({name: folder / "best.safetensors" for name, folder in runs.items()})
    curves = [read_curve(name.replace("_", " "), folder) for name, folder in runs.items()]
    # Energies of several models cannot be compared: each is measured from its own lowest.
    plot_curves(PLOT, curves, [min(curve.energy) for curve in curves])
    return [PICTURE, PLOT]


def _draw(weights: dict[str, Path]) -> None:
    scene = _scene()
    columns = {"as designed": scene.posed} | {
        name.replace("_", " "): load_model(path).draper.drape(scene) for name, path in weights.items()
    }
    with TileRenderer(210, 230) as renderer:
        tiles = []
        for title, hair in columns.items():
            notes = _notes(hair, scene)
            print(title, *notes, sep=", ")
            tiles.append(renderer.column(scene, hair, VIEWS, NATURAL_COLOURS[2], Caption(title, notes)))
    save_picture(PICTURE, grid([tiles]))


def _scene() -> Scene:
    """The groom on a body at rest, and on one whose head is turned."""
    body = load_body()
    clip, frame = TURNED
    poses = torch.stack([torch.zeros(81), bundled_clip(clip, body).body_pose[frame]])
    return Scene(make_groom(GROOM, body), BodyBatch(body, poses, torch.zeros(2, 10)))


def _notes(hair: Positions, scene: Scene) -> tuple[str, ...]:
    """Of the body at rest: what is kept of the groom; of both: what is inside the body."""
    inside = float(intersection_percent(hair, scene).mean())
    return (*what_is_kept(hair[:1], scene.posed[:1]), f"{inside:.2g} % inside the body")


if __name__ == "__main__":
    run_figure(main)
