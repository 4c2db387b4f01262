"""The animation at the top of the README: `python scripts/figures/animation.py 05_04.bvh`.

Three hairstyles in six seconds of a dance (CMU 05_04), every frame draped from the last one by the default draper; half
of the frames are drawn. The drapes are kept in `--folder`, so that the pictures can be drawn again.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image
from tiles import FIGURES, Colour, Picture, run_figure

import quaffure as qf
from quaffure.apps.render import NATURAL_COLOURS, Camera, StrandRenderer
from quaffure.body import BodyModel, Motion, load_body
from quaffure.hair import Groom, interpolation_of
from quaffure.io import replacing
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper
from quaffure.types import Positions

OUT = FIGURES / "dance.webp"
GROOMS = ("long_wavy", "ponytail", "curly_bob")
GUIDES, STRANDS = 1_200, 6_000
FRAMES, EVERY = "60:240", 2
WIDTH, HEIGHT, SUPERSAMPLING = 224, 256, 2
AZIMUTH_DEG, EXTENT, BELOW_HEAD = 20.0, 0.68, 0.16  # m
QUALITY, MOST_BYTES = 72, 1_500_000


def main(dance: tyro.conf.Positional[Path], folder: Path = Path("runs/animation")) -> list[Path]:
    body, clip = load_body(), qf.load_motion(str(dance)).frames(FRAMES)
    folder.mkdir(parents=True, exist_ok=True)
    films = []
    for name, colour in zip(GROOMS, NATURAL_COLOURS):
        groom = qf.load_groom(name).thinned(GUIDES)
        films.append(_film(_drape(groom, clip, body, folder / f"{name}.npy"), groom, clip, body, colour))
    pictures = [Image.fromarray(np.hstack(tiles)) for tiles in zip(*films)]
    more = {"append_images": pictures[1:], "duration": round(1000 * EVERY / clip.fps), "loop": 0}
    with replacing(OUT) as temporary:
        pictures[0].save(temporary, format="WEBP", save_all=True, quality=QUALITY, method=4, **more)
    assert OUT.stat().st_size <= MOST_BYTES, OUT.stat().st_size
    return [OUT]


def _scenes(groom: Groom, clip: Motion, body: BodyModel) -> Iterator[Scene]:
    """The frames, at the place of the first one."""
    for body_pose in clip.body_pose.split(1):
        yield Scene(groom, BodyBatch(body, body_pose, torch.zeros(1, 10)))


def _drape(groom: Groom, clip: Motion, body: BodyModel, kept: Path) -> Positions:
    if not kept.exists():
        draper, draped = CoherentDraper(), []
        for frame, scene in enumerate(_scenes(groom, clip, body)):
            draped.append(draper.drape(scene))
            print(f"{groom.name}: frame {frame} of {len(clip)}", end="\r", flush=True)
        np.save(kept, torch.cat(draped).numpy())
    return torch.from_numpy(np.load(kept))


def _film(draped: Positions, groom: Groom, clip: Motion, body: BodyModel, colour: Colour) -> Iterator[Picture]:
    """Tiles by a camera that travels with the head and does not turn."""
    between = interpolation_of(groom, body, STRANDS)
    with StrandRenderer(WIDTH, HEIGHT, supersampling=SUPERSAMPLING) as renderer:
        for scene, guides in list(zip(_scenes(groom, clip, body), draped))[::EVERY]:
            skin = scene.bodies.posed.vertices[0].numpy()
            centre = guides[:, 0].mean(dim=0).numpy() - [0.0, 0.0, BELOW_HEAD]
            camera = Camera.around(centre, EXTENT, AZIMUTH_DEG)
            yield renderer.render(between.strands(guides.numpy(), skin), skin, body.faces.numpy(), camera, colour)


if __name__ == "__main__":
    run_figure(main)
