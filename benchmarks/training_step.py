"""How many samples a second training takes, and where the time of a step goes.

    python benchmarks/training_step.py [GROOM ...]

One sample is one groom in one pose with all five loss terms, forward, backward and update. Run it on an idle machine.
"""

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import torch

from quaffure.body import load_body, load_pose_prior
from quaffure.energies import hair_energy
from quaffure.io.load_groom import load_groom
from quaffure.model import NeuralDraper
from quaffure.scene import BodyBatch
from quaffure.training import (
    AveragedAdam,
    DecoderRecipe,
    GroomedBody,
    PoseSampler,
    TrainConfig,
    Training,
    prior_validation,
)

WARM_UP, STEPS = 8, 24


class Stopwatch:
    """Wall time spent inside wrapped functions."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            result = function(*args, **kwargs)
            self.seconds[part] += time.perf_counter() - start
            return result

        return timed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("grooms", nargs="*", default=["long_straight", "bob"])
    options = parser.parse_args()
    body = load_body()
    grooms = tuple(load_groom(name, body) for name in options.grooms)
    # A step that is logged evaluates the energies once more, for their terms.
    config = TrainConfig(runs=3, frames=2, bf16=True, log_every=10_000)
    with TemporaryDirectory() as folder:
        recipe = DecoderRecipe(config, (GroomedBody(body, grooms),), PoseSampler(load_pose_prior()), prior_validation())
        measure(Training(recipe, Path(folder)))


def measure(training: Training[DecoderRecipe]) -> None:
    """Print samples per second, and the share of each part by wrapping the functions that a step calls."""
    steps = training.steps()
    for _ in range(WARM_UP):
        next(steps)
    times = []
    for _ in range(STEPS):
        start = time.perf_counter()
        next(steps)
        times.append(time.perf_counter() - start)
    samples = training.recipe.samples_per_step
    mean = statistics.mean(times)
    print(f"{samples / mean:.1f} samples/s, {1000 * mean / samples:.1f} ms a sample, {samples} samples a step")
    print(f"torch threads: {torch.get_num_threads()}, grooms: {[(g.name, len(g)) for g in training.recipe.grooms]}")

    watch = Stopwatch()
    parts = (
        (PoseSampler, "sample", "poses and shapes"),
        (hair_energy, "strand_energy", "Eqs. 6, 7, 9, 10, value and gradient"),
        (hair_energy, "fused_self_collision", "Eqs. 11-13, value and gradient"),
        (NeuralDraper, "deform", "posing and network, forward"),
        (torch.Tensor, "backward", "backward"),
        (AveragedAdam, "update", "update of weights and their average"),
    )
    patches = [mock.patch.object(owner, name, watch.around(part, getattr(owner, name))) for owner, name, part in parts]
    for cached, part in (("posed", "body"), ("surface", "contact search")):
        function = getattr(BodyBatch, cached).func
        patches.append(mock.patch.object(getattr(BodyBatch, cached), "func", watch.around(part, function)))
    for patch in patches:
        patch.start()
    start = time.perf_counter()
    for _ in range(STEPS):
        next(steps)
    total = time.perf_counter() - start
    mock.patch.stopall()
    # The body is posed inside the first groom's draping, its search structure inside the energy's arguments.
    watch.seconds["posing and network, forward"] -= watch.seconds["body"]
    watch.seconds["everything else"] = total - sum(watch.seconds.values())
    for part, seconds in sorted(watch.seconds.items(), key=lambda item: -item[1]):
        print(f"{100 * seconds / total:5.1f} %  {1000 * seconds / (STEPS * samples):6.2f} ms a sample  {part}")


if __name__ == "__main__":
    main()
