"""What pieces of the network are worth, on one groom.

    python scripts/ablation_table.py bob full=runs/ablation/full/best.safetensors NAME=FILE ... [--motion FILE.bvh ...]

Each network drapes the groom on the validation bodies and on every 60th frame of the motions. Excess is over the lowest
of `strand_newton` from its own start and from the drapes of all networks, in m g L per vertex.
"""

from pathlib import Path

import torch
import tyro

import quaffure as qf
from quaffure.benchmark import excess_energies
from quaffure.body import load_body
from quaffure.draper import Draper
from quaffure.energies.body_collision import intersection_percent
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper
from quaffure.training import prior_validation
from quaffure.types import BodyPose, BodyShape

EVERY = 60
COLUMNS = ("network", "excess, mean", "median", "90th percentile", "mean, ratio", "inside %", "ratio")


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
    drapers = {name: qf.load_model(file).draper for name, file in map(_named, weights)}
    excess, inside = [], []
    for index in range(len(pose)):
        scene = Scene(hair, BodyBatch(body, pose[index : index + 1], shape[index : index + 1]))
        above, within = _measured(scene, drapers)
        excess.append(above)
        inside.append(within)
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
    first: tuple[float, float] | None = None
    for name, own, within in zip(drapers, torch.tensor(excess).T, torch.tensor(inside).T, strict=True):
        mean, share = float(own.mean()), float(within.mean())
        first = first or (mean, share)
        ratios = [value / max(of_first, 1e-9) for value, of_first in zip((mean, share), first)]
        numbers = " | ".join(f"{value:.3f}" for value in (mean, float(own.median()), float(own.quantile(0.9))))
        print(f"| {name} | {numbers} | {ratios[0]:.2f} | {share:.4f} | {ratios[1]:.2f} |")


def _named(option: str) -> tuple[str, str]:
    name, is_given, file = option.partition("=")
    if not is_given:
        raise qf.InputError("weights", "NAME=FILE", f"'{option}'")
    return name, file


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
    inside = [float(intersection_percent(hair, scene)) for hair in drapes]
    return excess_energies(energy, scene, drapes, ends), inside


if __name__ == "__main__":
    tyro.cli(main)
