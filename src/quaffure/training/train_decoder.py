"""Self-supervised training of the deformation decoder, Sec. 3.5: fresh poses in, energy down."""

from dataclasses import asdict
from pathlib import Path

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
from quaffure.hair.groom import Groom
from quaffure.model.checkpoint import save_network
from quaffure.model.groom_code import load_groom_encoder
from quaffure.model.neural import NeuralDraper
from quaffure.model.quaffure_network import QuaffureNetwork, build_network
from quaffure.scene import BodyBatch, Scene
from quaffure.training.distributed import SINGLE_PROCESS, Worker
from quaffure.training.loop import Recipe
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.run_folder import body_digest
from quaffure.training.train_config import TrainConfig
from quaffure.training.validation import Validation, loss_unit, validation_metrics
from quaffure.types import Tensor

EMA_DECAY = 0.998
"""Decay of the weights' exponential average: over the last thousand steps or so."""
VALIDATED_GROOMS = 16
"""A validation measures about as many of the grooms, evenly spread over their list."""


class DecoderRecipe(Recipe):
    """The decoder's training for the shared loop (`quaffure.training.loop`).

    Random numbers of a step follow from seed, rank and step only.

    Attributes:
        energies: of each groom, in the material that hair has.
        strand_energies: the same with contact as strong as the loss has it, without Eq. 11.
        density_energies: Eq. 11 alone.
    """

    ema_decay = EMA_DECAY
    config: TrainConfig

    def __init__(
        self,
        config: TrainConfig,
        body: BodyModel,
        grooms: tuple[Groom, ...],
        sampler: PoseSampler,
        validation: Validation,
        worker: Worker = SINGLE_PROCESS,
        terms: Terms | None = None,
        network: QuaffureNetwork | None = None,
    ) -> None:
        """
        Args:
            grooms: registered to `body`, at most one strand a texel.
            worker: this process among those that share the run.
            terms: of the energy; those of `config.elastic` where none are given.
            network: a new one of `config.network` where none is given.
        """
        torch.manual_seed(config.seed)
        self.config, self.sampler, self.validation, self.worker = config, sampler, validation, worker
        self.body, self.grooms = body.to(worker.device), tuple(groom.to(worker.device) for groom in grooms)
        self.network = (network or build_network(config.network)).to(worker.device)
        self.network.encoder.load_state_dict(load_groom_encoder().state_dict())
        self.draper = NeuralDraper(self.network, config.material, config.bf16)
        terms = terms or hair_terms(config.elastic)
        self.energies = [HairEnergy(groom, config.material, terms) for groom in self.grooms]
        self.log_every, self.validate_every = config.log_every, config.validate_every
        drapes = config.runs * config.frames * min(config.grooms_per_step, len(grooms))
        self.samples_per_step = drapes * worker.world_size
        loss_energies = self.energies
        if config.body_contact_weight != 1:
            loss_energies = [HairEnergy(groom, config.loss_material, terms) for groom in self.grooms]
        self.strand_energies = [energy.without(SelfCollision.name) for energy in loss_energies]
        self.density_energies = [energy.only(SelfCollision.name) for energy in loss_energies]

    def backward(self, step: int) -> dict[str, float]:
        """The loss [`loss_unit`]; every `log_every` steps also every term of it."""
        config = self.config
        generator = torch.Generator().manual_seed(_step_seed(config.seed, self.worker.rank, step))
        body_pose, body_shape = self.sampler.sample(config.runs, config.frames, generator)
        bodies = BodyBatch(self.body, body_pose.to(self.worker.device), body_shape.to(self.worker.device))
        drawn = self._drawn_grooms(generator)
        metrics: dict[str, float] = {}
        for index in drawn:
            scene = Scene(self.grooms[index], bodies)
            loss, terms = self._loss(scene, index, len(drawn), step)
            (loss / len(drawn)).backward()
            for name, value in ({"loss": float(loss.detach())} | terms).items():
                metrics[name] = metrics.get(name, 0.0) + value / len(drawn)
        return metrics

    def _drawn_grooms(self, generator: torch.Generator) -> list[int]:
        if len(self.grooms) <= self.config.grooms_per_step:
            return list(range(len(self.grooms)))
        order = torch.randperm(len(self.grooms), generator=generator)
        drawn: list[int] = order[: self.config.grooms_per_step].tolist()
        return drawn

    def _loss(self, scene: Scene, index: int, grooms: int, step: int) -> tuple[Tensor, dict[str, float]]:
        """Eq. 1 over the batch of one of several grooms, in `loss_unit`, and the energy's terms where this step logs
        them."""
        config, unit = self.config, loss_unit(self.energies[index])
        draped = self.draper.deform(scene)
        # The gradient that arrives is that of the mean over samples and grooms.
        positions = clip_gradients(draped, self.energies[index].rest, len(draped) * grooms * unit)
        total = self.strand_energies[index].total(positions, scene)
        if step % config.self_collision_every == 0:
            total = total + config.self_collision_every * self.density_energies[index].total(positions, scene)
        head = world_from_head(self.body, scene.bodies.posed.joint_rotations)[:, None]
        deformation = ((positions - scene.posed) @ head).unflatten(0, (config.runs, config.frames))
        smoothness = energy_pose_regularization(deformation, config.material.k_pose_reg).mean() / config.frames
        terms: dict[str, float] = {}
        if self.worker.is_first and (step + 1) % config.log_every == 0:
            named = self.energies[index].by_term(draped.detach(), scene)
            terms = {name: float(term.mean()) / unit for name, term in named.items()}
            terms["pose_regularization"] = float(smoothness.detach()) / unit
        return (total.mean() + smoothness) / unit, terms

    def validate(self, averaged: QuaffureNetwork) -> dict[str, float]:
        """See `validation_metrics`; `loss` is the energy with contact as strong as in training."""
        draper = NeuralDraper(averaged, self.config.material, self.config.bf16)
        device = self.worker.device
        bodies = BodyBatch(self.body, self.validation.body_pose.to(device), self.validation.body_shape.to(device))
        every = -(-len(self.grooms) // VALIDATED_GROOMS)
        scenes = (Scene(groom, bodies) for groom in self.grooms[::every])
        metrics = validation_metrics(draper, zip(scenes, self.energies[::every]))
        metrics["loss"] = metrics["energy"] + (self.config.body_contact_weight - 1) * metrics["body_collision"]
        return metrics

    def save_best(
        self, path: Path, averaged: QuaffureNetwork, metrics: dict[str, float], notes: dict[str, str]
    ) -> None:
        names = ",".join(groom.name for groom in self.grooms)
        save_network(path, averaged, self.config.material, notes | {"grooms": names, "elastic": self.config.elastic})

    def description(self) -> dict[str, object]:
        return {
            "config": asdict(self.config),
            "grooms": [{"name": groom.name, "strands": len(groom)} for groom in self.grooms],
            "motions": [clip.name for clip in self.sampler.clips],
            "geometry": self.identity()["geometry"],
            "processes": self.worker.world_size,
            "device": str(self.worker.device),
        }

    def identity(self) -> dict[str, str]:
        """Grooms, network, material, what the loss is, and seed; the body, and the sizes of the grooms, which are made
        or registered again by every process, so that their last bits depend on the machine.
        """
        config, names = self.config, [groom.name for groom in self.grooms]
        weight = f"body contact {config.body_contact_weight:g} times, " if config.body_contact_weight != 1 else ""
        elastic = f"{config.elastic}, " if config.elastic != MODIFIED_COSSERAT else ""
        terms = self.energies[0].terms
        added = f"terms {[term.name for term in terms]}, " if terms != hair_terms(config.elastic) else ""
        return {
            "identity": f"{names}, {config.network}, {config.material}, {elastic}{added}{weight}seed {config.seed}",
            "geometry": f"body {body_digest(self.body)}, strands {[len(groom) for groom in self.grooms]}",
        }


def _step_seed(seed: int, rank: int, step: int) -> int:
    """A seed of one step of one worker; any two of them are as good as independent."""
    return int(np.random.SeedSequence((seed, rank, step)).generate_state(1, np.uint64)[0])
