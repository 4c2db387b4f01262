"""How far `strand_newton` is above the lowest energy found, by passes: `python scripts/newton_passes.py`.

Frame 60 of two bundled clips. The lowest is that of all rows and of 60 more passes from each of them and from the
network's drape. Energies in m g L per vertex.
"""

import torch

from quaffure.benchmark import excess_energies
from quaffure.body import bundled_clip, load_body
from quaffure.draper import Draper
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper, StrandNewtonSetting

STYLES = ("bob", "long_straight", "long_wavy", "long_ringlets", "afro", "ponytail")
CLIPS, FRAME, MORE_PASSES = ("neck_turn", "bow"), 60, 60
SETTINGS = {
    "12 passes": StrandNewtonSetting(passes=12),
    "16 passes": StrandNewtonSetting(passes=16),
    "20 passes": StrandNewtonSetting(),
}


def main() -> None:
    print(f"| style | clip | {' | '.join(SETTINGS)} |\n|---|---{'|---' * len(SETTINGS)}|")
    body, network = load_body(), load_model().draper
    rows = []
    for style in STYLES:
        groom = make_groom(style, body)
        for clip in CLIPS:
            pose = bundled_clip(clip, body).body_pose[FRAME : FRAME + 1]
            rows.append(_excesses(Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10))), network))
            print(f"| {style} | {clip} | {' | '.join(f'{value:.3f}' for value in rows[-1])} |", flush=True)
    print(f"| mean | | {' | '.join(f'{value:.3f}' for value in torch.tensor(rows).mean(dim=0).tolist())} |")


def _excesses(scene: Scene, network: Draper) -> list[float]:
    newton = StrandNewtonDraper()
    energy = newton.energy_of(scene)
    drapes = [StrandNewtonDraper(setting=setting).drape(scene) for setting in SETTINGS.values()]
    ends = [newton.settle(scene, start, MORE_PASSES) for start in (*drapes, network.drape(scene))]
    return excess_energies(energy, scene, drapes, ends)


if __name__ == "__main__":
    main()
