"""`quaffure train`: a network for grooms of one's own, from physics alone."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path

import tyro
from rich.progress import Progress, TimeRemainingColumn

from quaffure.apps.cli.console import console, progress_columns
from quaffure.apps.cli.inputs import motion_of
from quaffure.benchmark.evaluation_set import refuse_evaluation_data
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.pose_features import FEATURE_COUNT
from quaffure.body.pose_prior import load_pose_prior
from quaffure.errors import InputError
from quaffure.hair.clearance import rest_surface
from quaffure.hair.groom import Groom
from quaffure.io.load_groom import load_groom
from quaffure.model.checkpoint import load_network
from quaffure.model.quaffure_model import WEIGHTS
from quaffure.model.quaffure_network import QuaffureNetwork
from quaffure.training.distributed import Device, Worker, joined_workers
from quaffure.training.groom_samples import family_grooms
from quaffure.training.loop import Training, train
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.train_config import TrainConfig
from quaffure.training.train_decoder import DecoderRecipe
from quaffure.training.validation import prior_validation

SHIPPED = "shipped"


@dataclass(frozen=True)
class TrainCommand:
    """Train a network on grooms over sampled poses and shapes; carries on where an earlier run in the folder stopped.

    Poses come from the shipped prior, and from motion files where some are given. The folder then holds
    `best.safetensors`, the weights to drape with (`quaffure drape --weights`), `config.json`, the tables
    `training.csv` and `validation.csv`, and the checkpoint to carry on from. Several processes share a run when a
    launcher starts them: `torchrun --nproc-per-node 2 --no-python quaffure train ...`.
    """

    out: Path
    """Folder of the run; made where it does not exist."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled groom or a file; may be given several times. Grooms that are held out for evaluation are refused."""
    family: int = 0
    """Draws of the continuous family of hairstyles to train on besides, or instead."""
    motion: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """Motion files to train on besides the pose prior; may be given several times. Evaluation clips are refused."""
    body: Path | None = None
    """A body file (.npz, as `scripts/bake_body.py` writes it) instead of the shipped body."""
    weights: str | None = None
    """Weights to start from: a file, or `shipped`. The network's options are then those of the weights."""
    device: Device = "auto"
    """`auto` is CUDA where there is a device, else the CPU."""
    config: TrainConfig = field(default_factory=TrainConfig)

    def run(self) -> None:
        self._check()
        with joined_workers(self.device) as worker:
            begun = self._weights()
            config = self.config if begun is None else replace(self.config, network=begun.config)
            body = self._body()
            recipe = DecoderRecipe(config, body, self._grooms(body), self._sampler(body), prior_validation(), worker)
            training = Training(recipe, self.out)
            if training.resume():
                _say(worker, f"carrying on from step {training.step} of {config.steps}")
                if training.step >= config.steps:
                    return
            elif begun is not None:
                training.start_from(begun)
            with Progress(
                *progress_columns(TimeRemainingColumn()), console=console, disable=not worker.is_first
            ) as progress:
                train(training, _report(training, progress))

    def _check(self) -> None:
        """What a mistake can be told from before anything is loaded."""
        if self.config.network.pose_features not in (0, FEATURE_COUNT):
            expected = f"0 or {FEATURE_COUNT}"
            raise InputError("--pose-features", expected, f"{self.config.network.pose_features}")
        if self.family < 0:
            raise InputError("--family", "0 or more", f"{self.family}")
        if not self.groom and not self.family:
            raise InputError("--groom", "at least one groom, or draws of the --family", "none")
        refuse_evaluation_data(self.groom, self.motion)

    def _body(self) -> BodyModel:
        body, shipped = load_body(self.body), load_body()
        if body.joint_names != shipped.joint_names:
            # The pose prior, the clips and the pose features go by them.
            raise InputError(f"{self.body}", f"the joints {list(shipped.joint_names)}", f"{list(body.joint_names)}")
        return body

    def _grooms(self, body: BodyModel) -> tuple[Groom, ...]:
        own = [load_groom(name, body) for name in self.groom]
        # A groom file keeps the groom's name whatever the file is called.
        refuse_evaluation_data(groom.name for groom in own)
        surface = rest_surface(body)
        return (*own, *(drawn.groom(body, surface) for drawn in family_grooms(range(self.family))))

    def _sampler(self, body: BodyModel) -> PoseSampler:
        clips = tuple(motion_of(str(path), body) for path in self.motion)
        for clip in clips:
            if len(clip) < self.config.frames:
                raise InputError(f"motion '{clip.name}'", f"at least {self.config.frames} frames", f"{len(clip)}")
        return PoseSampler(load_pose_prior(), clips)

    def _weights(self) -> QuaffureNetwork | None:
        if self.weights is None:
            return None
        network, *_ = load_network(WEIGHTS if self.weights == SHIPPED else self.weights)
        if self.config.network not in (TrainConfig().network, network.config):
            raise InputError("--weights", f"the options of their network, {network.config}", f"{self.config.network}")
        return network


def _say(worker: Worker, text: str) -> None:
    if worker.is_first:
        console.print(text)


def _report(training: Training[DecoderRecipe], progress: Progress) -> Callable[[int, dict[str, float]], None]:
    """Moves the bar on at every step; a line with the time left at every validation, for logs without a terminal."""
    first, last, start = training.step, training.recipe.config.steps, time.monotonic()
    task = progress.add_task("training", total=last, completed=first)

    def report(step: int, figures: dict[str, float]) -> None:
        rate = figures["samples_per_second"]
        progress.update(task, completed=step, description=f"loss {figures['loss']:.3f}, {rate:.0f} samples/s")
        if "energy" in figures:
            left = timedelta(seconds=round((time.monotonic() - start) / (step - first) * (last - step)))
            inside, turned = figures["body_intersection_percent"], figures["orientation_error_deg"]
            progress.console.print(
                f"step {step} of {last}: energy {figures['energy']:.4f}, {inside:.2f} % inside the body, "
                f"{turned:.1f} deg from the posed groom; {left} left"
            )

    return report
