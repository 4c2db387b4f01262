"""Training of the supervised baseline: mean squared distance to what a solver draped, nothing of physics."""

import hashlib
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from quaffure.baselines.groomgen import head_strands, texel_cells
from quaffure.baselines.groomgen_network import DISPLACEMENT_UNIT, GroomGenLayers, GroomGenNetwork, save_groomgen
from quaffure.errors import InputError
from quaffure.io.atomic import replacing
from quaffure.training.averaged_adam import AveragedAdam, warm_cosine
from quaffure.training.groomgen_data import DrapedPoses, DrapeFolder, hair_of
from quaffure.training.run_folder import RunFolder
from quaffure.training.train_config import refuse_impossible
from quaffure.types import Float, Int, Positions, Tensor

VALIDATED = 0.1
"""Share of the poses that are not trained on."""
MEMORY = 0.99
"""Of the exponential average of the weights, which is what is validated and kept."""


@dataclass(frozen=True)
class GroomGenConfig:
    """One training run of the baseline; saved in its folder."""

    network: GroomGenLayers = field(default_factory=GroomGenLayers)
    steps: int = 6000
    """Optimizer steps in all."""
    batch: int = 16
    """Poses in a step."""
    learning_rate: float = 1e-3
    """Of Adam, at the start; falls to a hundredth along a cosine."""
    warmup: int = 100
    """Steps over which the learning rate rises from zero."""
    bf16: bool = False
    """Run the network's layers in bfloat16."""
    seed: int = 0
    """Of weights, batches, and of which poses are left for validation."""
    validate_every: int = 200
    """Steps between two validations; the best weights so far are kept."""
    save_every_seconds: float = 60.0
    """Seconds between two checkpoints that the run can be resumed from."""

    def __post_init__(self) -> None:
        counts = {"steps": self.steps, "batch": self.batch, "validate_every": self.validate_every}
        refuse_impossible(counts, self.learning_rate, self.seed)


class GroomGenTraining:
    """State of a run: network, optimizer, random numbers, step and the best figure, which `save` and `resume` keep."""

    def __init__(self, config: GroomGenConfig, drapes: DrapeFolder, data: DrapedPoses, folder: Path) -> None:
        """
        Args:
            data: the drapes of that folder, read.
            folder: for checkpoints, logs and weights; made where it does not exist.

        Raises:
            InputError: fewer than two poses, or two strands in a texel.
        """
        groom = drapes.groom
        if len(data) < 2:
            raise InputError(drapes.path, "two draped poses or more, one of them for validation", f"{len(data)}")
        if groom.texels().unique().numel() != len(groom):
            raise InputError(drapes.path, "one strand a texel (`select_guides`)", "several in one")
        torch.manual_seed(config.seed)
        self.config, self.drapes, self.data, self.folder = config, drapes, data, RunFolder(folder)
        self.network = GroomGenNetwork(config.network, head_strands(groom, drapes.body), texel_cells(groom))
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.generator = torch.Generator().manual_seed(config.seed)
        order = torch.randperm(len(data), generator=self.generator)
        kept = max(1, round(VALIDATED * len(data)))
        self.validated, self.trained = order[:kept], order[kept:]
        self.network.mean_displacement = _mean(data, self.trained)
        self.optimizer = AveragedAdam(self.network, config.learning_rate, MEMORY)
        self.step, self.best = 0, math.inf

    def train_step(self) -> float:
        """One step of Adam; the root mean square distance of the batch's vertices [mm]."""
        config = self.config
        drawn = torch.randint(len(self.trained), (config.batch,), generator=self.generator)
        loss = self._off(self.network, self.trained[drawn]).square().sum(-1).mean() / DISPLACEMENT_UNIT**2
        loss.backward()
        self.optimizer.update(warm_cosine(self.step, config.warmup, config.steps))
        self.step += 1
        return 1000 * DISPLACEMENT_UNIT * loss.item() ** 0.5

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Distances of the averaged network's vertices from the solver's [mm], over the poses that are not trained on;
        roots, which never move, are left out.
        """
        network = self.optimizer.averaged.eval()
        off = torch.cat([self._off(network, poses) for poses in self.validated.split(self.config.batch)])[:, :, 1:]
        posed = self.data.displacement[self.validated, :, 1:].float()
        return {
            "distance_mm": 1000 * float(off.norm(dim=-1).mean()),
            "rms_mm": 1000 * float(off.square().sum(-1).mean().sqrt()),
            "posed_distance_mm": 1000 * float(posed.norm(dim=-1).mean()),
        }

    def _off(self, network: GroomGenNetwork, poses: Int[Tensor, " b"]) -> Positions:
        """Where the network puts vertices, from where the solver did [m]."""
        with torch.autocast("cpu", torch.bfloat16, enabled=self.config.bf16):
            moved = network(self.data.turn[poses])
        return moved - self.data.displacement[poses].float()

    def keep_if_best(self, distance: float) -> None:
        """Write the averaged weights where no validation was better."""
        if not distance < self.best:
            return
        self.best = distance
        manifest = self.drapes.manifest
        notes = {
            "groom": manifest.groom,
            "step": str(self.step),
            "poses": f"{len(self.trained)}, and {len(self.validated)} for validation",
            "solver": manifest.solver,
            "validation_distance_mm": f"{distance:.4g}",
            "version": self.folder.version,
        }
        with replacing(self.folder.path / "best.safetensors") as path:
            save_groomgen(path, self.optimizer.averaged, hair_of(manifest), notes)

    def save(self) -> None:
        """Write everything that `resume` needs."""
        state = {"generator": self.generator.get_state(), "step": self.step, "best": self.best}
        self.folder.save(self.optimizer.state() | state | {"identity": self._identity()})

    def resume(self) -> bool:
        """Carry on from the folder's checkpoint; False where there is none. Later rows of the logs are dropped.

        Raises:
            InputError: it is of another run, or damaged.
        """
        state = self.folder.load(self._identity())
        if state is not None:
            with self.folder.reading():
                self.optimizer.restore(state)
                self.generator.set_state(state["generator"])
                self.step, self.best = int(state["step"]), float(state["best"])
        self.folder.rewind_logs(self.step)
        return state is not None

    def _identity(self) -> str:
        """What may not change in a run: drapes, network, seed."""
        manifest = self.drapes.manifest
        drapes = f"{len(self.data)} drapes {_digest(self.data.turn)} of {manifest.groom} {manifest.groom_digest}"
        return f"{drapes} by {manifest.solver}, {self.config.network}, seed {self.config.seed}"


def train(training: GroomGenTraining, report: Callable[[int, dict[str, float]], None]) -> None:
    """Carry a run on to its end, validating and saving on the way.

    Args:
        report: called after every step with the step and its figures: `train_rms_mm`, and those of `validate` when it
            was validated.
    """
    config, folder = training.config, training.folder
    folder.describe({"config": asdict(config), "drapes": asdict(training.drapes.manifest), "poses": len(training.data)})
    saved = time.perf_counter()
    while training.step < config.steps:
        figures = {"train_rms_mm": training.train_step()}
        validated = training.step % config.validate_every == 0 or training.step == config.steps
        if validated:
            figures |= training.validate()
            folder.log("validation", {"step": training.step, **figures})
            training.keep_if_best(figures["distance_mm"])
        report(training.step, figures)
        # Also after a validation: what it found best must not be forgotten by a run that is resumed.
        if validated or time.perf_counter() - saved > config.save_every_seconds:
            training.save()
            saved = time.perf_counter()


def _mean(data: DrapedPoses, poses: Int[Tensor, " b"]) -> Float[Tensor, "s n 3"]:
    """Displacement over some poses; summed one by one, for all of them at once in single precision take gigabytes."""
    total = torch.zeros(data.displacement.shape[1:])
    for pose in poses:
        total += data.displacement[pose]
    return total / len(poses)


def _digest(turn: Float[Tensor, "p 3"]) -> str:
    return hashlib.sha256(turn.numpy().tobytes()).hexdigest()[:8]
