"""The training loop that all trainings share; what they differ by is a `Recipe`.

    forward and backward  ->  mean gradients of all processes  ->  Adam  ->  average of the weights

with rows in `training.csv` and `validation.csv`, the best weights in `best.safetensors`, the newest in
`last.safetensors`, and a checkpoint from which a stopped run continues. A run that was killed and resumed ends with the
same bits as one that was not.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import nn

from quaffure.errors import InputError
from quaffure.io.atomic import replacing
from quaffure.training.averaged_adam import AveragedAdam, warm_cosine
from quaffure.training.distributed import SINGLE_PROCESS, Worker
from quaffure.training.run_folder import RunFolder
from quaffure.training.stop_request import stop_request

Metrics = dict[str, float]
BEST, LAST = "best.safetensors", "last.safetensors"
FIRST_SAVE_SECONDS = 20.0
"""After these there are weights and a checkpoint of a run, and it is seen to work."""


class Recipe(ABC):
    """What a training consists of.

    Attributes:
        config: has `steps`, `learning_rate`, `warmup` and `save_every_seconds`.
        network: what is trained.
        ema_decay: share of the weights' exponential average that is kept in a step.
        samples_per_step: of all processes.
        worker: this process among those that share the run.
        generator: of the random numbers of steps; None where they follow from the step's number.
        log_every: steps between two rows of `training.csv`; None without that table.
        validate_every: steps between two validations, of which the last step has one too; None without any.
        score: the metric of a validation of which the lowest value is the best.
    """

    config: Any
    network: Any
    ema_decay: float
    samples_per_step: int
    worker: Worker = SINGLE_PROCESS
    generator: torch.Generator | None = None
    log_every: int | None = None
    validate_every: int | None = None
    score: str = "loss"

    @abstractmethod
    def backward(self, step: int) -> Metrics:
        """Add the gradients of a step's loss to the network's; the metrics of the step."""

    @abstractmethod
    def description(self) -> dict[str, object]:
        """What `config.json` holds besides the version."""

    @abstractmethod
    def identity(self) -> dict[str, str]:
        """What may not change in a run: names of the checkpoint's entries, and what they have to be."""

    def validate(self, averaged: Any) -> Metrics:
        """Metrics of the averaged network on data that no step trains on."""
        raise NotImplementedError

    def save_weights(self, path: Path, averaged: Any, metrics: Metrics, notes: dict[str, str]) -> None:
        """Write the weights, ready to drape with; only where the recipe validates.

        Args:
            metrics: of the last validation; empty before the first one.
            notes: step and version of the code; more may be added.
        """
        raise NotImplementedError


R = TypeVar("R", bound=Recipe)


class Training(Generic[R]):
    """State of a run, which `save` and `resume` keep.

    Attributes:
        folder: checkpoints, logs and weights; only the first process writes.
        step: steps done.
        best: lowest score of a validation so far.
        seconds: time spent in steps.
    """

    def __init__(self, recipe: R, folder: Path) -> None:
        """
        Args:
            folder: made where it does not exist.

        Raises:
            InputError: it cannot be made.
        """
        self.recipe, self.folder = recipe, RunFolder(folder)
        self.optimizer: AveragedAdam[Any] = AveragedAdam(recipe.network, recipe.config.learning_rate, recipe.ema_decay)
        self.step, self.best, self.seconds = 0, math.inf, 0.0
        self._validated: Metrics = {}

    def start_from(self, network: nn.Module) -> None:
        """Take over the weights of a network before the first step.

        Raises:
            InputError: its layers are others.
        """
        try:
            self.optimizer.start_from(network.state_dict())
        except RuntimeError as error:
            raise InputError("--weights", "a network like that of the run", "other layers") from error

    def steps(self) -> Iterator[Metrics]:
        """Train to the last step. After each one: the recipe's metrics of this process's samples, learning rate, norm
        of the mean gradients, updates skipped so far, and rate [samples/s].
        """
        recipe, config = self.recipe, self.recipe.config
        while self.step < config.steps:
            start = time.perf_counter()
            metrics = recipe.backward(self.step)
            recipe.worker.average_gradients(recipe.network)
            share = warm_cosine(self.step, config.warmup, config.steps)
            norm = self.optimizer.update(share)
            elapsed = time.perf_counter() - start
            self.step += 1
            self.seconds += elapsed
            yield metrics | {
                "learning_rate": config.learning_rate * share,
                "gradient_norm": norm,
                "skipped_updates": float(self.optimizer.skipped),
                "samples_per_second": recipe.samples_per_step / elapsed,
            }

    def log(self, metrics: Metrics) -> None:
        """Append a row to `training.csv`."""
        self.folder.log("training", self._row(metrics))

    def validate(self) -> Metrics:
        """Measure the averaged network, log the metrics, and keep the weights where they are the best so far."""
        self._validated = metrics = self.recipe.validate(self.optimizer.averaged)
        if metrics[self.recipe.score] < self.best:
            self.best = metrics[self.recipe.score]
            self._save_weights(BEST)
        self.folder.log("validation", self._row(metrics))
        return metrics

    def save(self) -> None:
        """Write everything that `resume` needs, and the weights of now."""
        counters = torch.tensor([self.step, self.best, self.seconds], dtype=torch.float64)
        generator = self.recipe.generator
        random = {} if generator is None else {"generator": generator.get_state()}
        self.folder.save(self.optimizer.state() | {"counters": counters} | random | self.recipe.identity())
        if self.recipe.validate_every is not None:
            self._save_weights(LAST)

    def _save_weights(self, name: str) -> None:
        notes = {"step": str(self.step), "version": self.folder.version}
        with replacing(self.folder.path / name) as path:
            self.recipe.save_weights(path, self.optimizer.averaged, self._validated, notes)

    def resume(self) -> bool:
        """Continue from the folder's checkpoint, which the first process reads for all; False where there is none.

        Rows of the logs that are later than it are dropped, all of them where a run was killed before its first one.
        The number of processes may be another than before.

        Raises:
            InputError: it is of another run, or damaged.
        """
        worker = self.recipe.worker
        state = worker.broadcast_from_first(lambda: self.folder.load(self.recipe.identity()))
        if state is not None:
            with self.folder.reading():
                self.optimizer.restore(state)
                if self.recipe.generator is not None:
                    self.recipe.generator.set_state(state["generator"])
                self.step, self.best, self.seconds = _counters(state)
        if worker.is_first:
            # A run without a checkpoint starts again, and measures what it starts from again.
            self.folder.rewind_logs(-1 if state is None else self.step)
        return state is not None

    def _row(self, metrics: Metrics) -> dict[str, object]:
        rounded = {name: float(f"{value:.6g}") for name, value in metrics.items()}
        return {"step": self.step, "seconds": round(self.seconds, 1), **rounded}


def train(training: Training[Any], report: Callable[[int, Metrics], None]) -> None:
    """Continue a run to its end, logging, validating and saving on the way.

    Asked to stop by SIGINT, SIGTERM or SIGHUP, a run ends its step and saves first; where several processes share it,
    all do.

    Args:
        report: called after every step of the first process with the step and its metrics (`Training.steps`), after
            validations also theirs.

    Raises:
        KeyboardInterrupt: after SIGINT.
        SystemExit: after SIGTERM or SIGHUP.
    """
    recipe: Recipe = training.recipe
    with stop_request() as stop:
        steps = _until(training.steps(), lambda: recipe.worker.any(stop.is_made))
        if recipe.worker.is_first:
            training.folder.describe(recipe.description())
            _log_and_save(training, steps, report)
        else:
            for _ in steps:
                pass
    stop.follow()


def _until(steps: Iterator[Metrics], ends: Callable[[], bool]) -> Iterator[Metrics]:
    """The steps to the first one after which it ends."""
    for metrics in steps:
        yield metrics
        if ends():
            return


def _log_and_save(training: Training[Any], steps: Iterator[Metrics], report: Callable[[int, Metrics], None]) -> None:
    recipe: Recipe = training.recipe
    saved, interval = time.perf_counter(), min(FIRST_SAVE_SECONDS, recipe.config.save_every_seconds)
    for metrics in steps:
        # The first step too: a run without a table for minutes could as well hang.
        if recipe.log_every is not None and (training.step % recipe.log_every == 0 or training.step == 1):
            training.log(metrics)
        validated = recipe.validate_every is not None and (
            training.step % recipe.validate_every == 0 or training.step == recipe.config.steps
        )
        if validated:
            metrics |= training.validate()
        report(training.step, metrics)
        # Also after a validation: a resumed run needs the score of its best weights.
        if validated or time.perf_counter() - saved > interval:
            training.save()
            saved, interval = time.perf_counter(), recipe.config.save_every_seconds
    training.save()


def _counters(state: Mapping[str, Any]) -> tuple[int, float, float]:
    # Checkpoints of the groom code and of GroomGen once had a number each instead.
    counters = state["counters"].tolist() if "counters" in state else (state["step"], state.get("best", math.inf), 0.0)
    return int(counters[0]), float(counters[1]), float(counters[2])
