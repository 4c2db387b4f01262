"""The network on an imported body and on ours, same frames: the tables in docs/own_character.md.

    quaffure body import CHARACTER.glb --out my_body.npz
    python scripts/excess_on_character.py my_body.npz MOTION ... [--grooms GROOM ...] [--frames N] [--strands N]
        [--weights FILE]

Excess is over the lower of `strand_newton` from its own start and from the network's drape, in m g L per vertex, and
what each kind of energy adds to it. The first clip is the rest pose.
"""

from dataclasses import dataclass
from pathlib import Path
from statistics import mean, median

import torch
import tyro

from quaffure.body import BodyModel, load_body
from quaffure.energies import HairEnergy
from quaffure.energies.body_collision import BodyCollision, intersection_percent
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.self_collision import SelfCollision
from quaffure.hair import Groom
from quaffure.io.load_groom import load_groom
from quaffure.io.load_motion import load_motion
from quaffure.model.quaffure_model import Quaffure, load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper
from quaffure.types import Float, Positions, Tensor

KINDS = {SelfCollision.name: "hair", Cohesion.name: "hair", BodyCollision.name: "skin"}
"""Kind of each term; all others are `rod`: bending, stretching and weight."""
SHOWN = ("rod", "skin", "hair")
LEAST = 1e-3
"""Excess on our body below which a ratio says nothing [m g L]."""
COLUMNS = (
    "groom", "clip", "body", "inside %, mean", "worst", "excess, mean", "median", *SHOWN, "ratio of means",
    "of medians",
)  # fmt: skip


@dataclass(frozen=True)
class FrameResult:
    """One frame of the network's drape.

    Attributes:
        inside: share of the vertices in the body [%].
        excess: by kind of energy [m g L per vertex].
    """

    inside: float
    excess: dict[str, float]

    @property
    def total(self) -> float:
        return sum(self.excess.values())


def main(
    body: tyro.conf.Positional[Path],
    motions: tyro.conf.Positional[tuple[str, ...]],
    grooms: tuple[str, ...] = ("bob", "long_wavy", "ponytail"),
    frames: int = 6,
    strands: int = 4096,
    weights: Path | None = None,
) -> None:
    """Compare the network on two bodies.

    Args:
        body: file of the imported body.
        motions: clips besides the rest pose.
        grooms: bundled names or files.
        frames: of each clip, evenly spaced, its ends left out.
        strands: of each groom at most, evenly spaced; fewer are faster, and press less on each other.
        weights: of the network; the shipped ones by default.
    """
    bodies, model = {"ours": load_body(), "character": load_body(body)}, load_model(weights)
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|")
    for name in grooms:
        on_bodies = {key: load_groom(name, of).thinned(strands) for key, of in bodies.items()}
        for clip in ("rest", *motions):
            own: list[FrameResult] = []
            for key, of in bodies.items():
                results = measure(model.on(of), on_bodies[key], poses(clip, of, frames))
                own = own or results
                ratios = [] if key == "ours" else ratios_of(results, own)
                print(f"| {' | '.join([Path(name).stem, Path(clip).stem, key, *row(results), *ratios])} |", flush=True)


def poses(clip: str, body: BodyModel, frames: int) -> Float[Tensor, "f 81"]:
    if clip == "rest":
        return torch.zeros(1, 81)
    whole = load_motion(clip, body, in_place=True).body_pose
    return whole[torch.linspace(0, len(whole) - 1, frames + 2).round().long()[1:-1]]


def measure(model: Quaffure, groom: Groom, body_pose: Float[Tensor, "f 81"]) -> list[FrameResult]:
    solver = StrandNewtonDraper(model.draper.material)
    results = []
    for pose in body_pose.split(1):
        scene = Scene(groom, BodyBatch(model.body, pose, torch.zeros(1, 10)))
        hair, energy = model.drape(groom, pose), solver.energy_of(scene)
        lowest = min(
            (by_kind(energy, found, scene) for found in (solver.drape(scene), solver.drape_from(scene, hair))),
            key=lambda kinds: sum(kinds.values()),
        )
        own = by_kind(energy, hair, scene)
        excess = {kind: own[kind] - lowest[kind] for kind in SHOWN}
        results.append(FrameResult(float(intersection_percent(hair, scene)), excess))
    return results


def by_kind(energy: HairEnergy, hair: Positions, scene: Scene) -> dict[str, float]:
    """Energy of one frame by kind [m g L per vertex]."""
    found = dict.fromkeys(SHOWN, 0.0)
    for name, value in energy.by_term(hair, scene).items():
        found[KINDS.get(name, "rod")] += float(energy.per_vertex(value))
    return found


def row(results: list[FrameResult]) -> list[str]:
    inside, totals = [result.inside for result in results], [result.total for result in results]
    kinds = [f"{mean(result.excess[kind] for result in results):.3f}" for kind in SHOWN]
    return [f"{mean(inside):.3f}", f"{max(inside):.3f}", f"{mean(totals):.3f}", f"{median(totals):.3f}", *kinds]


def ratios_of(results: list[FrameResult], own: list[FrameResult]) -> list[str]:
    totals = [[result.total for result in part] for part in (results, own)]
    means = [[middle(part) for part in totals] for middle in (mean, median)]
    return [f"{of_body / of_ours:.1f}" if of_ours >= LEAST else "" for of_body, of_ours in means]


if __name__ == "__main__":
    tyro.cli(main)
