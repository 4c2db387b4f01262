"""`quaffure train-groomgen`: the supervised baseline, from drapes that a solver made."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Annotated

import tyro
from rich.progress import Progress, TimeRemainingColumn

from quaffure.apps.cli.console import console, progress_columns
from quaffure.body.body_model import load_body
from quaffure.training.groomgen_data import DrapedPoses, DrapeFolder
from quaffure.training.loop import Training, train
from quaffure.training.train_groomgen import GroomGenConfig, GroomGenRecipe


@dataclass(frozen=True)
class TrainGroomgenCommand:
    """Train GroomGen's neural simulator on the drapes of `quaffure groomgen-data`; carries on where it stopped.

    The folder then holds `best.safetensors`, the weights to drape with (`quaffure drape --draper groomgen --weights`),
    `config.json`, the table `validation.csv`, and the checkpoint to carry on from.
    """

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATA")]
    """Folder that `quaffure groomgen-data` filled. A tenth of its poses is for validation."""
    out: Path
    """Folder of the run; made where it does not exist."""
    config: GroomGenConfig = field(default_factory=GroomGenConfig)

    def run(self) -> None:
        drapes = DrapeFolder(self.data, load_body())
        with Progress(*progress_columns(TimeRemainingColumn()), console=console) as progress:
            training = Training(GroomGenRecipe(self.config, drapes, _read(drapes, progress)), self.out)
            if training.resume():
                console.print(f"carrying on from step {training.step}")
            train(training, _report(training, progress))
        if training.optimizer.skipped:
            console.print(f"{training.optimizer.skipped} updates skipped: gradients that were not finite")


def _read(drapes: DrapeFolder, progress: Progress) -> DrapedPoses:
    task = progress.add_task(f"reading drapes of {drapes.manifest.groom}", total=None)
    data = drapes.read(lambda poses: progress.update(task, completed=poses))
    progress.update(task, total=len(data))
    return data


def _report(training: Training[GroomGenRecipe], progress: Progress) -> Callable[[int, dict[str, float]], None]:
    """Moves the bar on at every step; a line with the time left at every validation, for logs without a terminal."""
    first, last, start = training.step, training.recipe.config.steps, time.monotonic()
    task = progress.add_task("training", total=last, completed=first)

    def report(step: int, figures: dict[str, float]) -> None:
        progress.update(task, completed=step, description=f"training, {figures['train_rms_mm']:.2f} mm rms")
        if "distance_mm" in figures:
            left = timedelta(seconds=round((time.monotonic() - start) / (step - first) * (last - step)))
            progress.console.print(
                f"step {step} of {last}: {figures['distance_mm']:.2f} mm from the solver on poses not trained on "
                f"(posed: {figures['posed_distance_mm']:.2f} mm); {left} left"
            )

    return report
