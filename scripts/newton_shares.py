"""Where the time of `strand_newton` goes: milliseconds of 12 passes, and their shares; a table in docs/solvers.md.

python scripts/newton_shares.py
"""

import time
from collections import Counter
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import torch
import tyro

from quaffure.body import bundled_clip, load_body
from quaffure.energies import fused_density
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandDescent, StrandNewtonDraper, StrandNewtonSetting, strand_descent

PARTS = (
    (strand_descent, "newton_rotations", "recursion"),
    (strand_descent, "evaluate_strands", "rod and contact"),
    (strand_descent, "self_collision_and_gradient", "density"),
    (strand_descent, "model_surroundings", "density"),
    (fused_density, "sort_particles", "cells"),  # a part of the density's time
)
PASSES, RUNS, FRAME = 12, 7, slice(60, 61)


def main(style: str = "long_straight") -> None:
    """Print a row for each clip and number of strands."""
    body = load_body()
    draper = StrandNewtonDraper(setting=StrandNewtonSetting(passes=PASSES))
    whole = make_groom(style, body)
    seconds: Counter[str] = Counter()
    for module, name, part in PARTS:
        setattr(module, name, _timed(getattr(module, name), part, seconds))
    print("| strands | clip | 12 passes [ms] | recursion % | rod % | contact % | density % | rest % | cells % |")
    print("|---" * 9 + "|")
    for groom in (whole, whole.select(torch.arange(0, len(whole), 4)[: len(whole) // 4])):
        for clip in ("neck_turn", "bow"):
            scene = Scene(groom, BodyBatch(body, bundled_clip(clip, body).body_pose[FRAME], torch.zeros(1, 10)))
            energy = draper.energy_of(scene)
            draper.descend(energy, scene)
            seconds.clear()
            every = [_seconds(lambda scene=scene, energy=energy: draper.descend(energy, scene)) for _ in range(RUNS)]
            taken = Counter(seconds)
            rod = _rod_share(draper.descend(energy, scene)) * taken["rod and contact"]
            parts = (taken["recursion"], rod, taken["rod and contact"] - rod, taken["density"])
            shares = [100 * part / sum(every) for part in parts]
            row = (len(groom), clip, f"{1000 * median(every):.0f}", *(f"{s:.0f}" for s in (*shares, 100 - sum(shares))))
            row = (*row, f"{100 * taken['cells'] / sum(every):.1f}")
            print(f"| {' | '.join(map(str, row))} |", flush=True)


def _timed(function: Callable[..., Any], part: str, seconds: Counter[str]) -> Callable[..., Any]:
    def timed(*arguments: Any) -> Any:
        begin = time.perf_counter()
        result = function(*arguments)
        seconds[part] += time.perf_counter() - begin
        return result

    return timed


def _rod_share(descent: StrandDescent) -> float:
    """Share of an evaluation that is left without contact."""

    def evaluated(k_body_collision: np.float32) -> float:
        descent._k_of_now = None
        return _seconds(lambda: descent._evaluate(k_body_collision))

    without, whole = ([evaluated(k) for _ in range(RUNS)] for k in (np.float32(0), descent._k_body_collision))
    return median(without) / median(whole)


def _seconds(run: Callable[[], object]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


if __name__ == "__main__":
    tyro.cli(main)
