"""How the styles hang with `strand_newton`: the table in docs/hanging.md.

python scripts/hanging_table.py [STYLE or FILE ...]; upright, and bowed in the middle of the bundled clip, each frame
alone.
"""

import sys
import time

import torch

from quaffure import load_groom
from quaffure.benchmark.appearance import in_the_air, off_vertical
from quaffure.body import BodyModel, bundled_clip, load_body
from quaffure.energies import HairEnergy, sag_free_rest
from quaffure.energies.body_collision import intersection_percent
from quaffure.energies.by_name import hair_terms
from quaffure.energies.sag_free import sag_free_report
from quaffure.hair import Groom
from quaffure.procedural import STYLES
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper

BOW = 60
PUSH = 20.0
"""Angle by which the outer half of every strand is turned in the push test [deg]."""
COLUMNS = (
    "style", "strands", "rest [s]", "residual", "stiffened %", "median scale", "above 10 %", "upright mean [mm]",
    "upright tips [mm]", "inside %", "push [1e-4]", "bow angle", "bow inside %", "in the air, design %", "bow %",
    "bow, held [mm]",
)  # fmt: skip


def main(names: list[str]) -> None:
    body = load_body()
    sag_free_rest(load_groom(names[0], body), body)  # so that no row has the time to compile or to load kernels
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|")
    for name in names:
        print(f"| {' | '.join(_row(load_groom(name, body), body))} |", flush=True)


def _row(groom: Groom, body: BodyModel) -> list[str]:
    begin = time.perf_counter()
    design = sag_free_rest(groom, body)
    seconds = time.perf_counter() - begin
    report = sag_free_report(groom, design)
    draper = StrandNewtonDraper(terms=hair_terms("rod", design))
    upright, bowed = (
        _scene(groom, body, torch.zeros(1, 81)),
        _scene(groom, body, bundled_clip("bow", body).body_pose[BOW : BOW + 1]),
    )
    settled, hanging = draper.drape(upright), draper.drape(bowed)
    distance = 1000 * (settled - upright.posed).norm(dim=-1)
    held = 1000 * (hanging - bowed.posed).norm(dim=-1)[:, :, 1:][:, design.rod.goal_weight > 0]
    return [
        groom.name,
        f"{len(groom)}",
        f"{seconds:.1f}",
        f"{report.largest_residual:.0e}",
        f"{report.stiffened_percent:.1f}",
        f"{report.median_scale:.2f}",
        f"{report.above_10_percent:.2f}",
        f"{float(distance.mean()):.2f}",
        f"{float(distance[..., -1].mean()):.2f}",
        f"{float(intersection_percent(settled, upright)):.3f}",
        f"{1e4 * _pushed(draper, upright):.1f}",
        f"{float(off_vertical(hanging)):.0f}",
        f"{float(intersection_percent(hanging, bowed)):.3f}",
        f"{_in_the_air(upright.posed, upright):.1f}",
        f"{_in_the_air(hanging, bowed):.1f}",
        f"{float(held.max()):.1f}" if held.numel() else "",
    ]


def _scene(groom: Groom, body: BodyModel, body_pose: torch.Tensor) -> Scene:
    return Scene(groom, BodyBatch(body, body_pose, torch.zeros(1, 10)))


def _pushed(draper: StrandNewtonDraper, scene: Scene) -> float:
    """Energy above the design's after hair has settled from where its outer half is turned [m g L per vertex]."""
    energy: HairEnergy = draper.energy_of(scene)
    outer = scene.posed.shape[2] // 2
    turned = scene.posed.clone()
    angle = torch.deg2rad(torch.tensor(PUSH))
    arm = turned[:, :, outer:] - turned[:, :, outer - 1 : outer]
    x, y = arm[..., 0].clone(), arm[..., 1].clone()
    arm[..., 0], arm[..., 1] = angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y
    turned[:, :, outer:] = turned[:, :, outer - 1 : outer] + arm
    settled = draper.settle(scene, turned, 60)
    return float(energy.per_vertex(energy.total(settled, scene) - energy.total(scene.posed, scene)))


def _in_the_air(hair: torch.Tensor, scene: Scene) -> float:
    return 100 * float(in_the_air(hair, scene).float().mean())


if __name__ == "__main__":
    main(sys.argv[1:] or list(STYLES))
