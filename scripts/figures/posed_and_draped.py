"""Fig. 3: hair that is only posed, and the network's drape of it below.

The body's skin is drawn opaque: where posed hair runs into a shoulder or the chest it ends there.
"""

from pathlib import Path

from tiles import (
    FIGURES,
    MOTION_FOLDER,
    Caption,
    Picture,
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

OUT = FIGURES / "posed_and_draped.jpg"
COLUMNS = (
    (CaseEntry("long_straight", "neck_turn", "a", (18,)), View(-20.0)),
    (CaseEntry("long_ringlets", "13_26", "e", (94,)), View(15.0)),
    (CaseEntry("beach_waves", "05_04", "b", (180,)), View(15.0)),
    (CaseEntry("side_part_lob", "07_01", "e", (36,)), View(150.0)),
    (CaseEntry("long_wavy", "05_04", "d", (252,)), View(15.0)),
    (CaseEntry("long_coils", "13_26", "d", (517,)), View(15.0)),
)


def main(motion_folder: Path = MOTION_FOLDER) -> list[Path]:
    model = load_model()
    above: list[Picture] = []
    below: list[Picture] = []
    with TileRenderer(240, 290) as renderer:
        scenes = load_scenes([entry for entry, _ in COLUMNS], motion_folder, model.body)
        for scene, (entry, view), colour in zip(scenes, COLUMNS, NATURAL_COLOURS):
            title = f"{entry.groom.replace('_', ' ')}, {entry.clip} {entry.frames[0]}, body {entry.shape}"
            for row, name, hair in (above, "posed", scene.posed), (below, "draped", model.draper.drape(scene)):
                inside = float(intersection_percent(hair, scene))
                (tile,) = renderer.tiles(scene, hair, view, colour)
                row.append(captioned(tile, Caption(title, (f"{name}: {inside:.2g} % inside the body",))))
    save_picture(OUT, grid([above, below]))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
