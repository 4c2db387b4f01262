"""Self-supervised training of the deformation decoder, Sec. 3.5: fresh poses in, energy down."""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import world_from_head
from quaffure.energies.energy_term import Terms
from quaffure.energies.force_limit import clip_gradients
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.hair_terms import MODIFIED_COSSERAT, hair_terms
from quaffure.energies.pose_regularization import energy_pose_regularization
from quaffure.energies.self_collision import SelfCollision
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.atomic import replacing
from quaffure.model.checkpoint import save_network
from quaffure.model.groom_code import load_groom_encoder
from quaffure.model.neural import NeuralDraper
from quaffure.model.quaffure_network import QuaffureNetwork, build_network
from quaffure.scene import BodyBatch, Scene
from quaffure.training.averaged_adam import AveragedAdam, warm_cosine
from quaffure.training.distributed import SINGLE_PROCESS, Worker
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.run_folder import RunFolder, body_digest
from quaffure.training.train_config import TrainConfig
from quaffure.training.validation import Validation, loss_unit, validation_figures
from quaffure.types import Tensor

MEMORY = 0.998
"""Of the exponential average of the weights: over the last thousand steps or so."""


VALIDATED_GROOMS = 16
"""Of many grooms about as many, evenly spread over their list, stand for all in a validation."""


class DecoderTraining:
    """State of a run: network, optimizer and step, which `save` and `resume` keep.

    Random numbers are no part of it: those of a step follow from seed, rank and step alone, so a run that was killed
    and resumed ends with the same bits as one that was not.
    """

    def __init__(
        self,
        config: TrainConfig,
        body: BodyModel,
        grooms: tuple[Groom, ...],
        sampler: PoseSampler,
        folder: Path,
        worker: Worker = SINGLE_PROCESS,
        terms: Terms | None = None,
    ) -> None:
        """
        Args:
            grooms: registered to `body`, at most one strand a texel.
            terms: of the energy; those of `config.elastic` where none are given.
            folder: for checkpoints, logs and weights; made where it does not exist.
            worker: which one this is of the processes that share the run; only the first one writes.

        Raises:
            InputError: the folder cannot be made.
        """
        torch.manual_seed(config.seed)
        self.config, self.sampler, self.worker = config, sampler, worker
        self.body, self.grooms = body.to(worker.device), tuple(groom.to(worker.device) for groom in grooms)
        self.folder = RunFolder(folder)
        network: QuaffureNetwork = build_network(config.network).to(worker.device)
        network.encoder.load_state_dict(load_groom_encoder().state_dict())
        self.optimizer = AveragedAdam(network, config.learning_rate, MEMORY)
        self.draper = NeuralDraper(network, config.material, config.bf16)
        terms = terms or hair_terms(config.elastic)
        self.energies = [HairEnergy(groom, config.material, terms) for groom in self.grooms]
        self.loss_energies = self.energies
        if config.body_contact_weight != 1:
            self.loss_energies = [HairEnergy(groom, config.loss_material, terms) for groom in self.grooms]
        self.step = 0
        self.best = float("inf")
        self.seconds = 0.0

    @property
    def samples_per_step(self) -> int:
        """Drapes in a step, of all workers."""
        of_each = self.config.runs * self.config.frames * min(self.config.grooms_per_step, len(self.grooms))
        return of_each * self.worker.world_size

    def steps(self) -> Iterator[dict[str, float]]:
        """Train to the last step. After each one: loss [`loss_unit`], learning rate, the gradient's norm, updates
        skipped so far and rate [samples/s]; every `log_every` steps also every term of the loss. Of this worker's
        samples, but for the norm.
        """
        while self.step < self.config.steps:
            start = time.perf_counter()
            figures = self._train_step()
            elapsed = time.perf_counter() - start
            self.step += 1
            self.seconds += elapsed
            yield figures | {"samples_per_second": self.samples_per_step / elapsed}

    def logs(self, step: int) -> bool:
        """Whether the loss is told term by term after so many steps."""
        return step % self.config.log_every == 0

    def _train_step(self) -> dict[str, float]:
        config = self.config
        generator = torch.Generator().manual_seed(_step_seed(config.seed, self.worker.rank, self.step))
        body_pose, body_shape = self.sampler.sample(config.runs, config.frames, generator)
        bodies = BodyBatch(self.body, body_pose.to(self.worker.device), body_shape.to(self.worker.device))
        drawn = self._drawn_grooms(generator)
        figures: dict[str, float] = {}
        for index in drawn:
            scene = Scene(self.grooms[index], bodies)
            loss, terms = self._loss(scene, index, len(drawn))
            (loss / len(drawn)).backward()
            for name, value in ({"loss": float(loss.detach())} | terms).items():
                figures[name] = figures.get(name, 0.0) + value / len(drawn)
        self.worker.average_gradients(self.draper.network)
        share = warm_cosine(self.step, config.warmup, config.steps)
        norm = self.optimizer.update(share)
        of_step = {"learning_rate": config.learning_rate * share, "gradient_norm": norm}
        return figures | of_step | {"skipped_updates": float(self.optimizer.skipped)}

    def _drawn_grooms(self, generator: torch.Generator) -> list[int]:
        if len(self.grooms) <= self.config.grooms_per_step:
            return list(range(len(self.grooms)))
        order = torch.randperm(len(self.grooms), generator=generator)
        drawn: list[int] = order[: self.config.grooms_per_step].tolist()
        return drawn

    def _loss(self, scene: Scene, index: int, grooms: int) -> tuple[Tensor, dict[str, float]]:
        """Eq. 1 over the batch of one of several grooms, in `loss_unit`, and the energy's terms where this step logs
        them."""
        config, energy, unit = self.config, self.loss_energies[index], loss_unit(self.energies[index])
        draped = self.draper.deform(scene)
        # The gradient that arrives is that of the mean over samples and grooms.
        positions = clip_gradients(draped, energy.rest, len(draped) * grooms * unit)
        total = energy.without(SelfCollision.name).total(positions, scene)
        if self.step % config.self_collision_every == 0:
            total = total + config.self_collision_every * energy.only(SelfCollision.name).total(positions, scene)
        head = world_from_head(self.body, scene.bodies.posed.joint_rotations)[:, None]
        deformation = ((positions - scene.posed) @ head).unflatten(0, (config.runs, config.frames))
        smoothness = energy_pose_regularization(deformation, config.material.k_pose_reg).mean() / config.frames
        terms: dict[str, float] = {}
        if self.worker.is_first and self.logs(self.step + 1):
            named = self.energies[index].by_term(draped.detach(), scene)
            terms = {name: float(term.mean()) / unit for name, term in named.items()}
            terms["pose_regularization"] = float(smoothness.detach()) / unit
        return (total.mean() + smoothness) / unit, terms

    def validate(self, validation: Validation) -> dict[str, float]:
        """Figures of the averaged network; logs them, and keeps the weights of the lowest loss so far."""
        draper = NeuralDraper(self.optimizer.averaged, self.config.material, self.config.bf16)
        device = self.worker.device
        bodies = BodyBatch(self.body, validation.body_pose.to(device), validation.body_shape.to(device))
        every = -(-len(self.grooms) // VALIDATED_GROOMS)
        scenes = (Scene(groom, bodies) for groom in self.grooms[::every])
        figures = validation_figures(draper, zip(scenes, self.energies[::every]))
        figures["loss"] = loss = figures["energy"] + (self.config.body_contact_weight - 1) * figures["body_collision"]
        if loss < self.best:
            self.best = loss
            names = ",".join(groom.name for groom in self.grooms)
            of_run = {"version": self.folder.version, "elastic": self.config.elastic}
            notes = {"step": str(self.step), "grooms": names, **of_run}
            with replacing(self.folder.path / "best.safetensors") as path:
                save_network(path, self.optimizer.averaged, self.config.material, notes)
        self.folder.log("validation", self._row(figures))
        return figures

    def log(self, figures: dict[str, float]) -> None:
        """Append a row to training.csv."""
        self.folder.log("training", self._row(figures))

    def _row(self, figures: dict[str, float]) -> dict[str, object]:
        rounded = {name: float(f"{value:.6g}") for name, value in figures.items()}
        return {"step": self.step, "seconds": round(self.seconds, 1), **rounded}

    def start_from(self, network: QuaffureNetwork) -> None:
        """Take over the weights of a network of the same configuration.

        Raises:
            InputError: its layers are others.
        """
        try:
            self.optimizer.start_from(network.state_dict())
        except RuntimeError as error:
            raise InputError("--weights", f"a network of {self.config.network}", "other layers") from error

    def describe(self) -> None:
        """Write what the run was asked for into its folder."""
        self.folder.describe(
            {
                "config": asdict(self.config),
                "grooms": [{"name": groom.name, "strands": len(groom)} for groom in self.grooms],
                "motions": [clip.name for clip in self.sampler.clips],
                "geometry": self._geometry(),
                "processes": self.worker.world_size,
                "device": str(self.worker.device),
            }
        )

    def save(self) -> None:
        """Write everything that `resume` needs."""
        state = {
            "counters": torch.tensor([self.step, self.best, self.seconds], dtype=torch.float64),
            "identity": self._identity(),
            "geometry": self._geometry(),
        }
        self.folder.save(self.optimizer.state() | state)

    def resume(self) -> bool:
        """Carry on from the folder's checkpoint, which the first worker reads for all; False where there is none.

        Rows of the logs that are later than it are dropped, all of them where a run was killed before its first one.
        The number of processes may be another than before.

        Raises:
            InputError: it is of another run, or damaged.
        """
        state: dict[str, Any] | None = self.worker.broadcast_from_first(lambda: self.folder.load(self._identity()))
        if state is not None:
            self._restore(state)
        if self.worker.is_first:
            self.folder.rewind_logs(self.step)
        return state is not None

    def _restore(self, state: dict[str, Any]) -> None:
        with self.folder.reading():
            # Checkpoints made before the geometry was kept have none.
            if state.get("geometry", self._geometry()) != self._geometry():
                raise InputError(self.folder.path, f"a run on {self._geometry()}", state["geometry"])
            self.optimizer.restore(state)
            step, self.best, self.seconds = state["counters"].tolist()
        self.step = int(step)

    def _identity(self) -> str:
        """What may not change in a run: grooms, network, material, what the loss is, and seed."""
        config, names = self.config, [groom.name for groom in self.grooms]
        weight = f"body contact {config.body_contact_weight:g} times, " if config.body_contact_weight != 1 else ""
        elastic = f"{config.elastic}, " if config.elastic != MODIFIED_COSSERAT else ""
        terms = self.energies[0].terms
        added = f"terms {[term.name for term in terms]}, " if terms != hair_terms(config.elastic) else ""
        return f"{names}, {config.network}, {config.material}, {elastic}{added}{weight}seed {config.seed}"

    def _geometry(self) -> str:
        """The body, and the sizes of the grooms, which are grown or registered anew by every process, so that their
        last bits depend on the machine.
        """
        return f"body {body_digest(self.body)}, strands {[len(groom) for groom in self.grooms]}"


def train(training: DecoderTraining, validation: Validation, report: Callable[[int, dict[str, float]], None]) -> None:
    """Carry a run on to its end, logging, validating and saving on the way.

    Args:
        report: called after every step of the first worker with the step and what is known of it (`steps`), after
            validations also their figures.
    """
    if not training.worker.is_first:
        for _ in training.steps():
            pass
        return
    training.describe()
    saved = time.perf_counter()
    for figures in training.steps():
        if training.logs(training.step):
            training.log(figures)
        if training.step % training.config.validate_every == 0 or training.step == training.config.steps:
            figures |= training.validate(validation)
        report(training.step, figures)
        if time.perf_counter() - saved > training.config.save_every_seconds:
            training.save()
            saved = time.perf_counter()
    training.save()


def _step_seed(seed: int, rank: int, step: int) -> int:
    """A seed of one step of one worker; any two of them are as good as independent."""
    return int(np.random.SeedSequence((seed, rank, step)).generate_state(1, np.uint64)[0])
