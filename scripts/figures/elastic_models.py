"""Fig. 10: curly hair by the elastic models of the paper, each with its default stiffness, settled by Adam.

`elastic_networks.py` trains a network with each, as the paper does.
"""

import time
from pathlib import Path

import torch
from tiles import FIGURES, Caption, TileRenderer, View, at_rest, grid, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.body import load_body
from quaffure.energies import ELASTIC_MODELS
from quaffure.energies.by_name import hair_terms
from quaffure.procedural import make_groom
from quaffure.scene import Scene
from quaffure.solvers import AdamDraper
from quaffure.types import Positions

OUT = FIGURES / "elastic_models.jpg"
GROOM = "long_ringlets"
VIEWS = (View(40.0, below_head=0.12), View(180.0, below_head=0.12))


def main() -> list[Path]:
    body = load_body()
    scene = at_rest(make_groom(GROOM, body), body)
    tiles = []
    with TileRenderer(260, 290) as renderer:
        for title, (hair, seconds) in {"as designed": (scene.posed, 0.0), **_settled(scene)}.items():
            notes = (*what_is_kept(hair, scene.posed), f"{seconds:.0f} s" if seconds else "")
            print(title, *notes, sep=", ")
            tiles.append(renderer.column(scene, hair, VIEWS, NATURAL_COLOURS[2], Caption(title, notes)))
    save_picture(OUT, grid([tiles]))
    return [OUT]


def _settled(scene: Scene) -> dict[str, tuple[Positions, float]]:
    """The drape by every elastic model and the processor time that it took [s]."""
    settled = {}
    for name in ELASTIC_MODELS:
        start = time.process_time()
        hair = AdamDraper(terms=hair_terms(name)).drape(scene)
        settled[name] = hair, time.process_time() - start
    return settled


def what_is_kept(hair: Positions, posed: Positions) -> tuple[str, str]:
    """How far the hair hangs, and what is left of its curls."""
    lower = 100 * float((posed - hair)[:, :, -1, 2].mean())
    return f"tips {lower:.1f} cm lower", f"curls {100 * _mean_turn(hair) / _mean_turn(posed):.0f} % as curved"


def _mean_turn(hair: Positions) -> float:
    """Mean angle between an edge and the next [rad]."""
    tangent = torch.nn.functional.normalize(hair.diff(dim=2), dim=-1)
    return float((tangent[:, :, 1:] * tangent[:, :, :-1]).sum(-1).clamp(-1, 1).acos().mean())


if __name__ == "__main__":
    run_figure(main)
