"""`quaffure train`: a network for grooms of one's own, from physics alone."""

from dataclasses import dataclass, field
from pathlib import Path

import torch
import tyro
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from quaffure.body.body_model import load_body
from quaffure.body.pose_features import FEATURE_COUNT
from quaffure.body.pose_prior import load_pose_prior
from quaffure.cli.console import console
from quaffure.cli.inputs import motion_of
from quaffure.drapers.quaffure_model import load_model
from quaffure.errors import InputError
from quaffure.evaluation.evaluation_set import evaluation_motions
from quaffure.io.load_groom import load_groom
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.train_decoder import DecoderTraining, TrainConfig, Validation, train

VALIDATION_POSES = 16
VALIDATION_SEED = 20_000


@dataclass(frozen=True)
class TrainCommand:
    """Train a network on grooms over sampled poses and shapes; carries on where an earlier run in the folder stopped.

    Poses come from the shipped prior, and from motion files where some are given. The folder then holds
    `best.safetensors`, the weights to drape with (`quaffure drape --weights`), and `validation.csv`.
    """

    out: Path
    """Folder of the run; made where it does not exist."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]]
    """A bundled groom or a file; may be given several times."""
    motion: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """Motion files to train on besides the pose prior; may be given several times. Evaluation clips are refused."""
    weights: Path | None = None
    """Weights to start from, of a network of the same configuration; fresh ones without it."""
    config: TrainConfig = field(default_factory=TrainConfig)

    def run(self) -> None:
        body = load_body()
        grooms = tuple(load_groom(name, body) for name in self.groom)
        sampler = PoseSampler(load_pose_prior(), tuple(motion_of(str(path), body) for path in self._allowed_motions()))
        if self.config.network.pose_features not in (0, FEATURE_COUNT):
            expected = f"0 or {FEATURE_COUNT}"
            raise InputError("--pose-features", expected, f"{self.config.network.pose_features}")
        for clip in sampler.clips:
            if len(clip) < self.config.frames:
                raise InputError(f"motion '{clip.name}'", f"at least {self.config.frames} frames", f"{len(clip)}")
        self.out.mkdir(parents=True, exist_ok=True)
        training = DecoderTraining(self.config, body, grooms, sampler, self.out)
        if training.resume():
            console.print(f"carrying on from step {training.step}")
        elif self.weights is not None:
            training.start_from(load_model(self.weights).draper.network)
        self._train(training, _validation(sampler))

    def _allowed_motions(self) -> tuple[Path, ...]:
        for path in self.motion:
            if path.stem in evaluation_motions():
                raise InputError(path, "a clip that is not in the evaluation set", path.stem)
        return self.motion

    def _train(self, training: DecoderTraining, validation: Validation) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console) as progress:
            task = progress.add_task("training", total=training.config.steps, completed=training.step)

            def report(step: int, figures: dict[str, float]) -> None:
                rate = figures["samples_per_second"]
                progress.update(task, completed=step, description=f"loss {figures['loss']:.3f}, {rate:.0f} samples/s")
                if "energy" in figures:
                    terms = ", ".join(f"{name} {value:.4f}" for name, value in figures.items() if name != "loss")
                    progress.console.print(f"step {step}: {terms}")

            train(training, validation, report)


def _validation(sampler: PoseSampler) -> Validation:
    """Poses and shapes drawn once from the same distribution by a generator of their own."""
    generator = torch.Generator().manual_seed(VALIDATION_SEED)
    return Validation(*sampler.sample(VALIDATION_POSES, 1, generator))
