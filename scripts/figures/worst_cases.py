"""Where the network is worst: frames of the evaluation with most hair inside the body, and with most energy to spare.

Reads docs/evaluation_results.json. Above the network's drape, below it that of `strand_newton`.
"""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tiles import (
    FIGURES,
    MOTION_FOLDER,
    Caption,
    TileRenderer,
    View,
    captioned,
    grid,
    run_figure,
    save_picture,
)

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.benchmark import DataFolders, load_cases, load_evaluation_set
from quaffure.model import load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper

OUT = FIGURES / "worst_cases.jpg"
RESULTS = FIGURES.parent / "evaluation_results.json"
GROOM_FOLDERS = (Path("data/grooms"), Path("data/grooms_evaluation"))
MOTION_FOLDERS = (MOTION_FOLDER, Path("data/motion_evaluation"))
SHOWN = (("body_intersection_percent", "{:.2f} % inside"), ("excess_energy", "{:.2f} m g L above"))
COUNT = 3
VIEW = View(15.0, extent=0.72, below_head=0.14)


class Worst(NamedTuple):
    case: str
    frame: int
    text: str


def worst_frames(metric: str, text: str) -> list[Worst]:
    """The worst frame of each of the worst cases, no groom twice."""
    found = []
    for case in json.loads(RESULTS.read_text())["cases"]:
        if metric in case["figures"]["neural"]:
            values = case["figures"]["neural"][metric]
            frame = int(np.argmax(values))
            found.append((values[frame], case["groom"], Worst(case["case"], frame, text.format(values[frame]))))
    worst, grooms = [], set()
    for _, groom, each in sorted(found, key=lambda row: -row[0]):
        if groom not in grooms and len(worst) < COUNT:
            worst.append(each)
            grooms.add(groom)
    return worst


def main(
    motion_folder: tuple[Path, ...] = MOTION_FOLDERS, groom_folder: tuple[Path, ...] = GROOM_FOLDERS
) -> list[Path]:
    model, of = load_model(), load_evaluation_set()
    entries = {entry.name: entry for entry in of.cases}
    columns = []
    with TileRenderer(240, 280) as renderer:
        for worst in [each for metric, text in SHOWN for each in worst_frames(metric, text)]:
            entry = entries[worst.case]
            (case,) = load_cases([entry], of, DataFolders(motion_folder, groom_folder), model.body)
            bodies = BodyBatch(model.body, case.motion.body_pose[worst.frame : worst.frame + 1], case.body_shape[None])
            scene = Scene(case.groom, bodies)
            drapes = (model.draper.drape(scene), StrandNewtonDraper(model.draper.material).drape(scene))
            pair = [renderer.tiles(scene, draped, VIEW, NATURAL_COLOURS[1])[0] for draped in drapes]
            where = f"{entry.clip} {case.frames[worst.frame]}, body {entry.shape}"
            columns.append(captioned(np.vstack(pair), Caption(entry.groom, (where, worst.text))))
            print(entry.groom, where, worst.text, sep=", ")
    save_picture(OUT, grid([columns]))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
