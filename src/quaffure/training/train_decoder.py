"""Self-supervised training of the deformation decoder, Sec. 3.5: fresh poses in, energy down."""

import csv
import json
import pickle
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import cast

import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import FEATURE_COUNT, world_from_head
from quaffure.config import HairMaterial
from quaffure.drapers.neural import NeuralDraper
from quaffure.drapers.scene import BodyBatch, Scene
from quaffure.energies.force_limit import limit_forces
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.pose_regularization import energy_pose_regularization
from quaffure.errors import InputError
from quaffure.geometry.clear_cells import REACH
from quaffure.groom.groom import Groom
from quaffure.io.atomic import replacing
from quaffure.networks.checkpoint import save_network
from quaffure.networks.quaffure_network import NetworkConfig, QuaffureNetwork, build_network
from quaffure.training.pose_sampler import PoseSampler
from quaffure.types import BodyPose, BodyShape, Tensor


@dataclass(frozen=True)
class TrainConfig:
    """One training run; saved in its folder."""

    network: NetworkConfig = field(default_factory=lambda: NetworkConfig(pose_features=FEATURE_COUNT))
    material: HairMaterial = field(default_factory=HairMaterial)
    steps: int = 20000
    """Optimizer steps in all."""
    runs: int = 4
    """Runs of consecutive frames in a step, each on a body of its own; a step's grooms are draped on all of them."""
    grooms_per_step: int = 4
    """Grooms in a step, drawn anew each time; all of them where there are no more."""
    frames: int = 2
    """Consecutive frames in a run (N_pose_reg of Eq. 14)."""
    learning_rate: float = 1e-3
    """Of Adam, at the start; falls to a hundredth along a cosine."""
    warmup: int = 200
    """Steps over which the learning rate rises from zero."""
    self_collision_every: int = 1
    """Evaluate Eq. 11 on every k-th step, k times as strong."""
    bf16: bool = False
    """Run the network's layers in bfloat16."""
    seed: int = 0
    validate_every: int = 250
    """Steps between two validations; the best weights so far are kept."""
    save_every_seconds: float = 120.0
    """Seconds between two checkpoints that the run can be resumed from."""

    def __post_init__(self) -> None:
        for name in ("steps", "runs", "frames", "grooms_per_step", "self_collision_every", "validate_every"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name.replace('_', '-')}", "1 or more", f"{getattr(self, name)}")
        if not 0 < self.material.collision_margin <= REACH:
            raise InputError("--collision-margin", f"up to {REACH} m", f"{self.material.collision_margin}")


@dataclass(frozen=True)
class Validation:
    """Poses that no step trains on; the same at every validation."""

    body_pose: BodyPose
    body_shape: BodyShape


class DecoderTraining:
    """State of a run: network, optimizer, random numbers and step, which `save` and `resume` keep."""

    def __init__(
        self, config: TrainConfig, body: BodyModel, grooms: tuple[Groom, ...], sampler: PoseSampler, folder: Path
    ) -> None:
        """
        Args:
            grooms: registered to `body`, at most one strand a texel.
            folder: an existing folder for checkpoints, logs and weights.
        """
        torch.manual_seed(config.seed)
        self.config, self.body, self.grooms, self.sampler, self.folder = config, body, grooms, sampler, folder
        self.network = build_network(config.network)
        self.draper = NeuralDraper(self.network, config.material, config.bf16)
        self.average = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(0.998))
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, betas=(0.9, 0.99))
        self.generator = torch.Generator().manual_seed(config.seed)
        self.energies = [HairEnergy(groom, config.material) for groom in grooms]
        self.step = 0
        self.best = float("inf")
        self.seconds = 0.0

    @property
    def averaged(self) -> QuaffureNetwork:
        """The exponential average of the weights over the last thousand steps or so: what is validated and kept."""
        return cast(QuaffureNetwork, self.average.module)

    def steps(self) -> Iterator[dict[str, float]]:
        """Train to the last step, yielding after each one the loss [`_joules`] and the rate [samples/s]."""
        samples = self.config.runs * self.config.frames * min(self.config.grooms_per_step, len(self.grooms))
        while self.step < self.config.steps:
            start = time.perf_counter()
            loss = self._train_step()
            elapsed = time.perf_counter() - start
            self.step += 1
            self.seconds += elapsed
            yield {"loss": loss, "samples_per_second": samples / elapsed}

    def _train_step(self) -> float:
        config = self.config
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * _schedule(self.step, config.warmup, config.steps)
        body_pose, body_shape = self.sampler.sample(config.runs, config.frames, self.generator)
        self.optimizer.zero_grad(set_to_none=True)
        bodies = BodyBatch(self.body, body_pose, body_shape)
        mean_loss = 0.0
        drawn = self._drawn_grooms()
        for index in drawn:
            loss = self._loss(Scene(self.grooms[index], bodies), self.energies[index], len(drawn)) / len(drawn)
            loss.backward()
            mean_loss += float(loss.detach())
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimizer.step()
        self.average.update_parameters(self.network)
        return mean_loss

    def _drawn_grooms(self) -> list[int]:
        if len(self.grooms) <= self.config.grooms_per_step:
            return list(range(len(self.grooms)))
        order = torch.randperm(len(self.grooms), generator=self.generator)
        drawn: list[int] = order[: self.config.grooms_per_step].tolist()
        return drawn

    def _loss(self, scene: Scene, energy: HairEnergy, grooms: int) -> Tensor:
        """Eq. 1 over the batch of one of several grooms, in units of `_joules`."""
        config = self.config
        draped = self.draper.deform(scene, energy.rest)
        # The gradient that arrives is that of the mean over samples and grooms.
        positions = limit_forces(draped, energy.rest, len(draped) * grooms * _joules(energy))
        total = energy.along_strands(positions, scene.director, scene.surface)
        if self.step % config.self_collision_every == 0:
            total = total + config.self_collision_every * energy.self_collision(positions)
        head = world_from_head(self.body, scene.bodies.posed.joint_rotations)[:, None]
        deformation = ((positions - scene.posed) @ head).unflatten(0, (config.runs, config.frames))
        smoothness = energy_pose_regularization(deformation, config.material.k_pose_reg)
        return (total.mean() + smoothness.mean() / config.frames) / _joules(energy)

    def validate(self, validation: Validation) -> dict[str, float]:
        """Energy terms of the averaged network in `_joules`, mean over grooms; keeps the best weights so far."""
        draper = NeuralDraper(self.averaged, self.config.material)
        sums: dict[str, float] = {}
        bodies = BodyBatch(self.body, validation.body_pose, validation.body_shape)
        with torch.no_grad():
            for groom, energy in zip(self.grooms, self.energies):
                scene = Scene(groom, bodies)
                for name, value in energy.terms(draper.drape(scene), scene.director, scene.surface).items():
                    sums[name] = sums.get(name, 0.0) + float(value.mean()) / (_joules(energy) * len(self.grooms))
        sums["energy"] = sum(sums.values())
        if sums["energy"] < self.best:
            self.best = sums["energy"]
            notes = {"step": str(self.step), "grooms": ",".join(groom.name for groom in self.grooms)}
            with replacing(self.folder / "best.safetensors") as path:
                save_network(path, self.averaged, self.config.material, notes)
        self._log({"step": self.step, "seconds": round(self.seconds, 1), **{k: round(v, 6) for k, v in sums.items()}})
        return sums

    def start_from(self, network: QuaffureNetwork) -> None:
        """Take over the weights of a network of the same configuration.

        Raises:
            InputError: its layers are others.
        """
        try:
            self.network.load_state_dict(network.state_dict())
        except RuntimeError as error:
            raise InputError("--weights", f"a network of {self.config.network}", "other layers") from error
        self.average = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(0.998))

    def save(self) -> None:
        """Write everything that `resume` needs."""
        state = {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "counters": torch.tensor([self.step, self.best, self.seconds], dtype=torch.float64),
            "identity": self._identity(),
        }
        with replacing(self.folder / "checkpoint.pt") as path:
            torch.save(state, path)
        with replacing(self.folder / "config.json") as path:
            path.write_text(json.dumps(asdict(self.config), indent=1))

    def resume(self) -> bool:
        """Carry on from the folder's checkpoint; False where there is none.

        Raises:
            InputError: it is of another run, or damaged.
        """
        path = self.folder / "checkpoint.pt"
        if not path.is_file():
            return False
        try:
            state = torch.load(path, weights_only=True)
            identity = state["identity"]
        except (RuntimeError, KeyError, EOFError, pickle.UnpicklingError) as error:
            raise InputError(path, "a checkpoint of a training run", str(error).splitlines()[0]) from error
        if identity != self._identity():
            raise InputError(self.folder, f"a run of {self._identity()}", identity)
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"])
        step, self.best, self.seconds = state["counters"].tolist()
        self.step = int(step)
        return True

    def _identity(self) -> str:
        """What may not change in a run: grooms, network, material and seed."""
        config = self.config
        return f"{[groom.name for groom in self.grooms]}, {config.network}, {config.material}, seed {config.seed}"

    def _log(self, row: dict[str, float]) -> None:
        path = self.folder / "validation.csv"
        new = not path.exists()
        with path.open("a", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(row))
            if new:
                writer.writeheader()
            writer.writerow(row)


def train(training: DecoderTraining, validation: Validation, report: Callable[[int, dict[str, float]], None]) -> None:
    """Carry a run on to its end, validating and saving on the way.

    Args:
        report: called after every step with the step and what is known: loss and rate, after validations also terms.
    """
    config = training.config
    saved = time.perf_counter()
    for figures in training.steps():
        if training.step % config.validate_every == 0 or training.step == config.steps:
            figures |= training.validate(validation)
        report(training.step, figures)
        if time.perf_counter() - saved > config.save_every_seconds:
            training.save()
            saved = time.perf_counter()
    training.save()


def _joules(energy: HairEnergy) -> float:
    """The unit of a groom's loss [J]: m g L plus k_Cosserat, a vertex.

    For long hair the first is all; in stubble a bend costs a thousand times what its weight does, and short grooms
    would drown the others.
    """
    return energy.per_vertex_unit + energy.rest.mass.numel() * energy.material.k_cosserat


def _schedule(step: int, warmup: int, steps: int) -> float:
    """Linear rise, then a cosine down to a hundredth."""
    rise = min(1.0, (step + 1) / max(1, warmup))
    return rise * (0.01 + 0.99 * 0.5 * (1 + float(torch.cos(torch.tensor(torch.pi * step / steps)))))
