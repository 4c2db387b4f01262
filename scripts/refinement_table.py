"""What `--refine K` buys and costs: the table in docs/training.md, over the first frames of the evaluation's cases.

python scripts/refinement_table.py MOTION_FOLDER GROOM_FOLDER; processor time of whatever threads there are.
"""

import sys
import time
from pathlib import Path

import numpy as np

from quaffure.benchmark import DataFolders, load_cases, load_evaluation_set
from quaffure.benchmark.metrics import metrics
from quaffure.draper import Draper
from quaffure.energies import HairEnergy
from quaffure.model import load_model
from quaffure.scene import Scene
from quaffure.solvers import RefinedDraper

STEPS = (0, 1, 3, 10, 30)
EVERY = 3
METRICS = ("body_intersection_percent", "orientation_error_deg", "density_excess_percent", "energy")


def main(motion_folder: str, groom_folder: str) -> None:
    model, of = load_model(), load_evaluation_set()
    folders = DataFolders(Path(motion_folder), Path(groom_folder))
    entries = [entry for entry in of.cases if folders.missing(entry, of) is None][::EVERY]
    rows: dict[int, list[list[float]]] = {steps: [] for steps in STEPS}
    for case in load_cases(entries, of, folders, model.body):
        for steps in STEPS:
            draper: Draper = RefinedDraper(model.draper, steps) if steps else model.draper
            rows[steps].append(_measured(draper, Scene(case.groom, case.bodies(model.body, 0))))
    print(f"{len(entries)} frames")
    print("| K | inside the body [%] | degrees from posed | hair pressed into hair [%] | energy | processor ms |")
    print("|---|---|---|---|---|---|")
    for steps, measured in rows.items():
        means = np.mean([row[:-1] for row in measured], axis=0)
        took = np.median([row[-1] for row in measured])
        print(f"| {steps} | {means[0]:.3f} | {means[1]:.2f} | {means[2]:.2f} | {means[3]:.3f} | {took:.0f} |")


def _measured(draper: Draper, scene: Scene) -> list[float]:
    """Metrics, and the processor time of a second drape [ms]: the first may compile."""
    draper.drape(scene)
    start = time.process_time()
    draped = draper.drape(scene).detach()
    took = 1000 * (time.process_time() - start)
    values = metrics(draped, scene, HairEnergy(scene.groom, draper.material))
    return [*(float(values[name]) for name in METRICS), took]


if __name__ == "__main__":
    main(*sys.argv[1:])
