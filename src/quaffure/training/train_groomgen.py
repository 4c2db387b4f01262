"""Training of the supervised baseline: mean squared distance to what a solver draped, nothing of physics."""

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from quaffure.baselines.groomgen import head_strands, texel_cells
from quaffure.baselines.groomgen_network import DISPLACEMENT_UNIT, GroomGenLayers, GroomGenNetwork, save_groomgen
from quaffure.digest import array_digest
from quaffure.errors import InputError
from quaffure.training.groomgen_data import DrapedPoses, DrapeFolder
from quaffure.training.loop import Recipe
from quaffure.training.train_config import refuse_impossible
from quaffure.types import Float, Int, Positions, Tensor

VALIDATED = 0.1
"""Share of the poses that are not trained on."""
EMA_DECAY = 0.99
"""Decay of the weights' exponential average, which is what is validated and kept."""


@dataclass(frozen=True)
class GroomGenConfig:
    """One training run of the baseline; saved in its folder."""

    network: GroomGenLayers = field(default_factory=GroomGenLayers)
    steps: int = 6000
    """Optimizer steps in all."""
    batch: int = 16
    """Poses in a step."""
    learning_rate: float = 1e-3
    """The learning rate at the start; falls to a hundredth along a cosine."""
    warmup: int = 100
    """Steps over which the learning rate rises from zero."""
    bf16: bool = False
    """Run the network's layers in bfloat16."""
    seed: int = 0
    """Seed of weights, batches, and of which poses are left for validation."""
    validate_every: int = 200
    """Steps between two validations; the best weights so far are kept."""
    save_every_seconds: float = 60.0
    """Seconds between two checkpoints that the run can be resumed from."""

    def __post_init__(self) -> None:
        counts = {"steps": self.steps, "batch": self.batch, "validate_every": self.validate_every}
        refuse_impossible(counts, self.learning_rate, self.seed)


class GroomGenRecipe(Recipe):
    """The baseline's training for the shared loop (`quaffure.training.loop`).

    Attributes:
        validated, trained: numbers of the poses that are left for validation, and of all others.
    """

    ema_decay, score = EMA_DECAY, "distance_mm"
    config: GroomGenConfig
    network: GroomGenNetwork

    def __init__(self, config: GroomGenConfig, drapes: DrapeFolder, data: DrapedPoses) -> None:
        """
        Args:
            data: the drapes of that folder, read.

        Raises:
            InputError: fewer than two poses, or two strands in a texel.
        """
        groom = drapes.groom
        if len(data) < 2:
            raise InputError(drapes.path, "two draped poses or more, one of them for validation", f"{len(data)}")
        if groom.texels().unique().numel() != len(groom):
            raise InputError(drapes.path, "one strand a texel (`select_guides`)", "several in one")
        torch.manual_seed(config.seed)
        self.config, self.drapes, self.data = config, drapes, data
        self.network = GroomGenNetwork(config.network, head_strands(groom, drapes.body), texel_cells(groom))
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.generator = torch.Generator().manual_seed(config.seed)
        order = torch.randperm(len(data), generator=self.generator)
        kept = max(1, round(VALIDATED * len(data)))
        self.validated, self.trained = order[:kept], order[kept:]
        self.network.mean_displacement = _mean(data, self.trained)
        self.samples_per_step, self.validate_every = config.batch, config.validate_every
        self._train_rms_mm = math.nan

    def backward(self, step: int) -> dict[str, float]:
        """The root mean square distance of the batch's vertices from the solver's [mm]."""
        drawn = torch.randint(len(self.trained), (self.config.batch,), generator=self.generator)
        loss = self._off(self.network, self.trained[drawn]).square().sum(-1).mean() / DISPLACEMENT_UNIT**2
        loss.backward()
        self._train_rms_mm = 1000 * DISPLACEMENT_UNIT * loss.item() ** 0.5
        return {"train_rms_mm": self._train_rms_mm}

    @torch.no_grad()
    def validate(self, averaged: GroomGenNetwork) -> dict[str, float]:
        """Distances of the network's vertices from the solver's [mm], over the poses that are not trained on; roots,
        which never move, are left out. `train_rms_mm` is that of the last step.
        """
        network = averaged.eval()
        off = torch.cat([self._off(network, poses) for poses in self.validated.split(self.config.batch)])[:, :, 1:]
        posed = self.data.displacement[self.validated, :, 1:].float()
        return {
            "train_rms_mm": self._train_rms_mm,
            "distance_mm": 1000 * float(off.norm(dim=-1).mean()),
            "rms_mm": 1000 * float(off.square().sum(-1).mean().sqrt()),
            "posed_distance_mm": 1000 * float(posed.norm(dim=-1).mean()),
        }

    def _off(self, network: GroomGenNetwork, poses: Int[Tensor, " b"]) -> Positions:
        """Where the network puts vertices, from where the solver did [m]."""
        with torch.autocast("cpu", torch.bfloat16, enabled=self.config.bf16):
            moved = network(self.data.turn[poses])
        return moved - self.data.displacement[poses].float()

    def save_weights(
        self, path: Path, averaged: GroomGenNetwork, metrics: dict[str, float], notes: dict[str, str]
    ) -> None:
        manifest = self.drapes.manifest
        more = {
            "groom": manifest.groom,
            "poses": f"{len(self.trained)}, and {len(self.validated)} for validation",
            "solver": manifest.solver,
        }
        if "distance_mm" in metrics:
            more["validation_distance_mm"] = f"{metrics['distance_mm']:.4g}"
        save_groomgen(path, averaged, manifest.material, notes | more)

    def description(self) -> dict[str, object]:
        return {"config": asdict(self.config), "drapes": asdict(self.drapes.manifest), "poses": len(self.data)}

    def identity(self) -> dict[str, str]:
        """Drapes, network and seed."""
        manifest = self.drapes.manifest
        drapes = (
            f"{len(self.data)} drapes {array_digest(self.data.turn)[:8]} of {manifest.groom} {manifest.groom_digest}"
        )
        return {"identity": f"{drapes} by {manifest.solver}, {self.config.network}, seed {self.config.seed}"}


def _mean(data: DrapedPoses, poses: Int[Tensor, " b"]) -> Float[Tensor, "s n 3"]:
    """Displacement over some poses; summed one by one, for all of them at once in single precision take gigabytes."""
    total = torch.zeros(data.displacement.shape[1:])
    for pose in poses:
        total += data.displacement[pose]
    return total / len(poses)
