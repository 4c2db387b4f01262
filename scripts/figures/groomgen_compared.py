"""Fig. 8: one groom by the supervised baseline, by the network and by the solver that the baseline was fitted to.

At turns of the head that the baseline was not trained on. The small pictures show only the strands that have a vertex
inside the body, on the bare body. Needs weights of `quaffure train-groomgen` (docs/groomgen.md).
"""

from pathlib import Path

import numpy as np
import torch
from tiles import FIGURES, GAP, PAPER, Caption, Picture, TileRenderer, View, captioned, grid, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.baselines import load_groomgen
from quaffure.benchmark.metrics import metrics
from quaffure.body import BodyModel, neck_pose
from quaffure.draper import Draper
from quaffure.energies import HairEnergy, hair_terms
from quaffure.energies.body_collision import inside_body
from quaffure.io.load_groom import load_groom
from quaffure.model import load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import solver
from quaffure.training import random_head_rotation
from quaffure.types import Positions

OUT = FIGURES / "groomgen_compared.jpg"
WEIGHTS = Path("runs/groomgen/bob/best.safetensors")
POSES = (100_001, 100_004)  # numbers far beyond those that any training draws
VIEW, INSET = View(35.0, extent=0.5), View(35.0, extent=0.36, below_head=0.1)
WIDTH, INSET_WIDTH = 330, 150  # pixels
MARKED = (0.75, 0.02, 0.02)


def main(weights: Path = WEIGHTS) -> list[Path]:
    model, (groomgen, notes) = load_model(), load_groomgen(weights)
    scene = _scene(notes["groom"], model.body)
    material = model.draper.material
    rows: dict[str, Draper] = {
        "groomgen": groomgen,
        "neural": model.draper,
        notes["solver"]: solver(notes["solver"], material, hair_terms()),
    }
    columns = []
    with TileRenderer(WIDTH, WIDTH) as renderer, TileRenderer(INSET_WIDTH, INSET_WIDTH) as small:
        for name, draper in rows.items():
            hair = draper.drape(scene)
            measured = metrics(hair, scene, HairEnergy(scene.groom, material))
            tiles = renderer.tiles(scene, hair, VIEW, NATURAL_COLOURS[0])
            marked = _marked(scene, hair, small)
            column = [_with_inset(tile, inset) for tile, inset in zip(tiles, marked)]
            means = {key: values.mean() for key, values in measured.items()}
            caption = Caption(
                name,
                (
                    f"{means['body_intersection_percent']:.2g} % inside the body",
                    f"lengths {means['length_error_percent']:.2g} % off",
                    f"{means['orientation_error_deg']:.1f}° from the posed groom",
                ),
            )
            print(name, *caption.notes, sep=", ")
            columns.append(captioned(np.vstack(column), caption))
    save_picture(OUT, grid([columns]))
    return [OUT]


def _scene(groom: str, body: BodyModel) -> Scene:
    turns = torch.stack([random_head_rotation(0, pose) for pose in POSES])
    return Scene(load_groom(groom, body), BodyBatch(body, neck_pose(body, turns), torch.zeros(len(POSES), 10)))


def _marked(scene: Scene, hair: Positions, renderer: TileRenderer) -> list[Picture]:
    """The bare body, with nothing but the strands that go into it."""
    through = inside_body(hair, scene).any(dim=2)
    return [
        renderer.strands_alone(strands[marked], scene.bodies, sample, INSET, MARKED)
        for sample, (strands, marked) in enumerate(zip(hair, through))
    ]


def _with_inset(tile: Picture, inset: Picture) -> Picture:
    """The small picture in the lower right corner, within a frame."""
    framed = np.full((INSET_WIDTH + GAP, INSET_WIDTH + GAP, 3), PAPER, np.uint8)
    framed[GAP:, GAP:] = inset
    tile = tile.copy()
    tile[-len(framed) :, -len(framed) :] = framed
    return tile


if __name__ == "__main__":
    run_figure(main)
