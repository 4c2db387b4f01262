"""The animation at the top of the README: `python scripts/figures/animation.py 05_04.bvh`.

Three hairstyles in a dance (CMU 05_04, 297 frames), every frame draped from the last one by the default draper; half of
the frames are drawn. The drapes are kept in `--folder`, so that the pictures can be drawn again.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from PIL import Image
from tiles import FIGURES, Picture, run_figure

import quaffure as qf
from quaffure.apps.render import NATURAL_COLOURS, Camera, StrandRenderer
from quaffure.body import BodyModel, load_body
from quaffure.hair import interpolation_of
from quaffure.io import read_drape, replacing

OUT = FIGURES / "dance.webp"
GROOMS = ("long_wavy", "ponytail", "curly_bob")
COLOURS = (NATURAL_COLOURS[0], NATURAL_COLOURS[1], NATURAL_COLOURS[2])
WIDTH, HEIGHT, STRANDS, SUPERSAMPLING = 224, 256, 10_000, 3
GUIDES = 1_200
EVERY = 2
EXTENT, BELOW_HEAD = 0.68, 0.16  # m
QUALITY, MOST_BYTES = 52, 1_500_000


def main(dance: tyro.conf.Positional[Path], folder: Path = Path("runs/animation")) -> list[Path]:
    body = load_body()
    folder.mkdir(parents=True, exist_ok=True)
    films = [_film(_drape(name, dance, folder), name, body, colour) for name, colour in zip(GROOMS, COLOURS)]
    pictures = [Image.fromarray(np.hstack(tiles)) for tiles in zip(*films)]
    milliseconds = round(1000 * EVERY / 30)
    with replacing(OUT) as temporary:
        pictures[0].save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=pictures[1:],
            duration=milliseconds,
            loop=0,
            quality=QUALITY,
            method=6,
        )
    assert OUT.stat().st_size <= MOST_BYTES, OUT.stat().st_size
    return [OUT]


def _groom(name: str) -> qf.Groom:
    return qf.load_groom(name).thinned(GUIDES)


def _drape(name: str, dance: Path, folder: Path) -> qf.DrapeSequence:
    path = folder / f"{name}.npz"
    if not path.exists():
        qf.save_drape(qf.drape_clip(_groom(name), qf.load_motion(str(dance))), path)
    return read_drape(path)


def _film(seq: qf.DrapeSequence, name: str, body: BodyModel, colour: tuple[float, float, float]) -> Iterator[Picture]:
    """Tiles by a camera that travels with the head and does not turn."""
    seq, between = seq.in_place(), interpolation_of(_groom(name), body, STRANDS)
    with StrandRenderer(WIDTH, HEIGHT, supersampling=SUPERSAMPLING) as renderer:
        for frame in range(0, len(seq), EVERY):
            skin = seq.body_vertices[frame]
            strands = between.strands(seq.strands[frame], skin)
            centre = seq.strands[frame, :, 0].mean(axis=0) - [0.0, 0.0, BELOW_HEAD]
            yield renderer.render(strands, skin, seq.body_faces, Camera.around(centre, EXTENT, 20.0), colour)


if __name__ == "__main__":
    run_figure(main)
