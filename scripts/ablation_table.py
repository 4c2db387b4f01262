"""What pieces of the network are worth: the ablation table in docs/training.md.

    python scripts/ablation_table.py bob full=runs/ablation/full/best.safetensors NAME=FILE ... [--motion FILE.bvh ...]

Each network drapes the groom on the validation bodies and on every 60th frame of the motions. Excess is over the lowest
of `strand_newton` from its own start and from the drapes of all networks, in m g L per vertex.
"""

from pathlib import Path

import torch
import tyro

import quaffure as qf
from quaffure.body import load_body
from quaffure.draper import Draper
from quaffure.energies.body_collision import intersection_percent
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper
from quaffure.training import prior_validation
from quaffure.types import BodyPose, BodyShape

EVERY = 60
COLUMNS = ("network", "excess, mean", "median", "nine in ten below", "relative to the first", "inside %", "relative")


def main(
    groom: tyro.conf.Positional[str], weights: tyro.conf.Positional[tuple[str, ...]], motion: tuple[Path, ...] = ()
) -> None:
    """Print a row for each network.

    Args:
        groom: a bundled groom.
        weights: NAME=FILE of each; ratios are to the first.
        motion: files that no training used.
    """
    body = load_body()
    hair = qf.load_groom(groom, body)
    pose, shape = _bodies(motion)
    drapers = {name: qf.load_model(file).draper for name, file in (option.split("=", 1) for option in weights)}
    excess, inside = [], []
    for index in range(len(pose)):
        scene = Scene(hair, BodyBatch(body, pose[index : index + 1], shape[index : index + 1]))
        above, within = _measured(scene, drapers)
        excess.append(above)
        inside.append(within)
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
    first: tuple[float, float] | None = None
    for name, own, within in zip(drapers, torch.tensor(excess).T, torch.tensor(inside).T):
        mean, share = float(own.mean()), float(within.mean())
        first = first or (mean, share)
        row = (f"{mean:.3f}", f"{float(own.median()):.3f}", f"{float(own.quantile(0.9)):.3f}", f"{mean / first[0]:.2f}")
        print(f"| {name} | {' | '.join(row)} | {share:.4f} | {share / max(first[1], 1e-9):.2f} |")


def _bodies(motions: tuple[Path, ...]) -> tuple[BodyPose, BodyShape]:
    """Poses and shapes of the validation, then frames of the motions on the mean shape."""
    validation = prior_validation()
    frames = [qf.load_motion(path).body_pose[::EVERY] for path in motions]
    pose = torch.cat([validation.body_pose, *frames])
    shape = torch.zeros(len(pose), validation.body_shape.shape[1])
    shape[: len(validation.body_shape)] = validation.body_shape
    return pose, shape


def _measured(scene: Scene, drapers: dict[str, Draper]) -> tuple[list[float], list[float]]:
    """Excess [m g L per vertex] and share of the vertices inside the body [%] of each draper."""
    newton = StrandNewtonDraper()
    energy = newton.energy_of(scene)
    drapes = [draper.drape(scene) for draper in drapers.values()]
    ends = [newton.drape(scene), *(newton.drape_from(scene, start) for start in drapes)]
    energies = [float(energy.per_vertex(energy.total(hair, scene))) for hair in (*drapes, *ends)]
    inside = [float(intersection_percent(hair, scene)) for hair in drapes]
    return [value - min(energies) for value in energies[: len(drapes)]], inside


if __name__ == "__main__":
    tyro.cli(main)
