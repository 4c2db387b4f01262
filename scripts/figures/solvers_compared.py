"""Fig. 7: one hairstyle and pose by the network and by solvers of the same energy, with metrics.

Times are of one core, in processor time. `--slow` adds `adam` and `lbfgs`, which take minutes.
"""

import time
from pathlib import Path
from statistics import median

import torch
from numba import set_num_threads
from tiles import (
    FIGURES,
    MOTION_FOLDER,
    Caption,
    TileRenderer,
    View,
    grid,
    load_scenes,
    run_figure,
    save_picture,
)

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.benchmark import CaseEntry
from quaffure.benchmark.methods import methods
from quaffure.benchmark.metrics import metrics
from quaffure.body import load_body
from quaffure.draper import Draper
from quaffure.energies import HairEnergy
from quaffure.hair import Groom
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Positions

OUT = FIGURES / "solvers_compared.jpg"
FRAME = CaseEntry("long_ringlets", "13_26", "e", (94,))
FAST, SLOW = ("posed", "neural", "neural_settled", "strand_newton"), ("adam", "lbfgs")
VIEWS = (View(15.0), View(-150.0))
SLOW_SECONDS, REPEATS = 1.0, 5  # s; what takes longer is timed by the run that drapes
WARM_UP_STRANDS = 8


def main(motion_folder: Path = MOTION_FOLDER, slow: bool = False) -> list[Path]:
    torch.set_num_threads(1)
    set_num_threads(1)
    (scene,) = load_scenes([FRAME], motion_folder, load_body())
    tiles = []
    with TileRenderer(240, 270) as renderer:
        for row in methods(FAST + SLOW if slow else FAST, {}):
            draped, milliseconds = _timed(row.draper, scene)
            measured = metrics(draped, scene, HairEnergy(scene.groom, row.draper.material))
            values = {key: float(value) for key, value in measured.items()}
            notes = (
                f"{values['body_intersection_percent']:.2g} % inside the body",
                f"{values['orientation_error_deg']:.1f}° from the posed groom",
                f"energy {values['energy']:.3f} m g L a vertex",
                f"{milliseconds:.{0 if milliseconds >= 10 else 1}f} ms",
            )
            print(row.name, *notes, sep=", ")
            tiles.append(renderer.column(scene, draped, VIEWS, NATURAL_COLOURS[1], Caption(row.name, notes)))
    save_picture(OUT, grid([tiles]))
    return [OUT]


def _timed(draper: Draper, scene: Scene) -> tuple[Positions, float]:
    """A drape, and the processor time that it takes from codes and pose in to strands out [ms]."""
    few = scene.groom.select(torch.arange(WARM_UP_STRANDS))
    _drape(draper, few, scene.bodies)  # compiles, loads
    draped, seconds = _drape(draper, scene.groom, scene.bodies)
    if seconds < SLOW_SECONDS:
        seconds = median(_drape(draper, scene.groom, scene.bodies)[1] for _ in range(REPEATS))
    return draped, 1000 * seconds


def _drape(draper: Draper, groom: Groom, bodies: BodyBatch) -> tuple[Positions, float]:
    # A scene of its own: the body is posed within the time.
    scene = Scene(groom, BodyBatch(bodies.body, bodies.body_pose, bodies.body_shape))
    start = time.process_time()
    draped = draper.drape(scene).detach()
    return draped, time.process_time() - start


if __name__ == "__main__":
    run_figure(main)
