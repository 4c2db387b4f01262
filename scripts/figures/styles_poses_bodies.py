"""Fig. 4: the network on many hairstyles, each on another pose and body; clips and bodies that no training used."""

from pathlib import Path

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

OUT = FIGURES / "styles_poses_bodies.jpg"
VIEW = View(20.0)
COLUMNS = 6
# Straight, wavy and curly hair, a row each, from long to short.
ENTRIES = (
    CaseEntry("long_straight", "13_26", "a", (141,)),
    CaseEntry("long_fringe", "05_04", "b", (90,)),
    CaseEntry("side_part_lob", "07_01", "c", (36,)),
    CaseEntry("bob_fringe", "05_04", "d", (252,)),
    CaseEntry("pixie", "13_26", "e", (564,)),
    CaseEntry("half_up", "07_01", "a", (8,)),
    CaseEntry("long_wavy", "05_04", "c", (216,)),
    CaseEntry("beach_waves", "13_26", "d", (235,)),
    CaseEntry("layered_shag", "05_04", "e", (162,)),
    CaseEntry("wavy_bob", "07_01", "b", (52,)),
    CaseEntry("mullet", "13_26", "c", (658,)),
    CaseEntry("short_waves", "05_04", "a", (180,)),
    CaseEntry("long_ringlets", "13_26", "b", (517,)),
    CaseEntry("long_coils", "05_04", "a", (72,)),
    CaseEntry("curly_bob", "07_01", "e", (68,)),
    CaseEntry("afro", "05_04", "d", (270,)),
    CaseEntry("short_curly", "13_26", "a", (94,)),
    CaseEntry("short_coils", "07_01", "c", (36,)),
)


def main(motion_folder: Path = MOTION_FOLDER) -> list[Path]:
    model = load_model()
    tiles = []
    with TileRenderer(220, 270) as renderer:
        for index, (entry, scene) in enumerate(zip(ENTRIES, load_scenes(ENTRIES, motion_folder, model.body))):
            draped = model.draper.drape(scene)
            (tile,) = renderer.tiles(scene, draped, VIEW, NATURAL_COLOURS[index % len(NATURAL_COLOURS)])
            inside = float(intersection_percent(draped, scene))
            note = f"{entry.clip} {entry.frames[0]}, body {entry.shape}, {inside:.2g} % inside"
            tiles.append(captioned(tile, Caption(entry.groom.replace("_", " "), (note,))))
    save_picture(OUT, grid([tiles[first : first + COLUMNS] for first in range(0, len(tiles), COLUMNS)]))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
