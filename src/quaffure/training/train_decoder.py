"""Self-supervised training of the deformation decoder, Sec. 3.5: fresh poses in, energy down."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import world_from_head
from quaffure.energies.by_name import ROD, hair_terms
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.energy_term import Terms
from quaffure.energies.force_limit import clip_gradients
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.energies.pose_regularization import energy_pose_regularization
from quaffure.hair.groom import Groom
from quaffure.model.checkpoint import save_network
from quaffure.model.groom_code import load_groom_encoder
from quaffure.model.neural import NeuralDraper
from quaffure.model.quaffure_network import QuaffureNetwork, build_network
from quaffure.scene import BodyBatch, Scene
from quaffure.training.distributed import SINGLE_PROCESS, Worker
from quaffure.training.loading_sampler import draw_loading
from quaffure.training.loop import Recipe
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.run_folder import body_digest
from quaffure.training.train_config import TrainConfig
from quaffure.training.validation import Validation, energy_above_offset, loss_unit, validation_metrics
from quaffure.types import BodyPose, BodyShape, Tensor

EMA_DECAY = 0.998
"""Decay of the weights' exponential average: over the last thousand steps or so."""
VALIDATED_GROOMS = 16
"""A validation measures about as many of the grooms, evenly spread over their list."""


@dataclass(frozen=True)
class GroomedBody:
    """A body to train on, and the grooms that are registered to it, at most one strand a texel."""

    body: BodyModel
    grooms: tuple[Groom, ...]


class DecoderRecipe(Recipe):
    """The decoder's training for the shared loop (`quaffure.training.loop`).

    Random numbers of a step follow from seed, rank and step only.

    Attributes:
        grooms: of all bodies, one body's after another's.
        energies: of each groom, in the material that hair has.
    """

    ema_decay = EMA_DECAY
    config: TrainConfig

    def __init__(
        self,
        config: TrainConfig,
        groomed: tuple[GroomedBody, ...],
        sampler: PoseSampler,
        validation: Validation,
        worker: Worker = SINGLE_PROCESS,
        terms: Terms | None = None,
        network: QuaffureNetwork | None = None,
    ) -> None:
        """
        Args:
            groomed: bodies with the same joints as the sampler's poses, and their grooms.
            worker: this process among those that share the run.
            terms: of the energy; those of `config.elastic` where none are given.
            network: a new one of `config.network` where none is given.
        """
        torch.manual_seed(config.seed)
        self.config, self.sampler, self.validation, self.worker = config, sampler, validation, worker
        bodies = [one.body.to(worker.device) for one in groomed]
        self.bodies = tuple(body for body, one in zip(bodies, groomed) for _ in one.grooms)
        self.grooms = tuple(groom.to(worker.device) for one in groomed for groom in one.grooms)
        self.network = (network or build_network(config.network)).to(worker.device)
        self.network.encoder.load_state_dict(load_groom_encoder().state_dict())
        self.draper = NeuralDraper(self.network, config.material, config.bf16)
        self.own_terms = terms
        self.energies = [self._energy(*pair) for pair in zip(self.grooms, self.bodies)]
        self.log_every, self.validate_every, self.score = config.log_every, config.validate_every, "log_energy"
        drapes = config.runs * config.frames * min(config.grooms_per_step, len(self.grooms))
        self.samples_per_step = drapes * worker.world_size

    def _energy(self, groom: Groom, body: BodyModel) -> HairEnergy:
        terms, material = self.own_terms or hair_terms(self.config.elastic), self.config.material
        if self.own_terms is None and self.config.elastic == ROD:
            terms = terms_of_design(groom, body, material)
        return HairEnergy(groom, material, terms)

    def _loaded(self, index: int, loading: Loading) -> HairEnergy:
        """The energy of a groom under a loading."""
        if loading is STANDARD_LOADING:
            return self.energies[index]
        terms = terms_of_design(self.grooms[index], self.bodies[index], self.config.material, loading)
        return self.energies[index].of_terms(terms)

    @property
    def draws_loadings(self) -> bool:
        """Whether stiffness, gravity and wind change from step to step: the energy of the rod alone has them, and the
        paper's configuration does not read them."""
        reads = self.network.config.predicts_directions
        return reads and self.own_terms is None and self.config.elastic == ROD

    def backward(self, step: int) -> dict[str, float]:
        """The loss [`loss_unit`]; in the first step and every `log_every` steps also every term of it."""
        config = self.config
        generator = torch.Generator().manual_seed(_step_seed(config.seed, self.worker.rank, step))
        drawn_bodies = self.sampler.sample(config.runs, config.frames, generator)
        drawn = self._drawn_grooms(generator)
        scenes = self._scenes(drawn, *drawn_bodies)
        metrics: dict[str, float] = {}
        for index, scene in zip(drawn, scenes):
            loading = draw_loading(generator) if self.draws_loadings else STANDARD_LOADING
            objective, of_groom = self._objective(scene, self._loaded(index, loading), loading, len(drawn), step)
            (objective / len(drawn)).backward()
            for name, value in of_groom.items():
                metrics[name] = metrics.get(name, 0.0) + value / len(drawn)
        return metrics

    def _drawn_grooms(self, generator: torch.Generator) -> list[int]:
        if len(self.grooms) <= self.config.grooms_per_step:
            return list(range(len(self.grooms)))
        order = torch.randperm(len(self.grooms), generator=generator)
        drawn: list[int] = order[: self.config.grooms_per_step].tolist()
        return drawn

    def _scenes(self, indices: Sequence[int], body_pose: BodyPose, body_shape: BodyShape) -> Iterator[Scene]:
        """Grooms one by one, each on its body in all poses and shapes; those of one body share its posed surface.

        The shape of an imported body is its own: nothing of it changes with the coefficients, which the network reads.
        """
        pose, shape = body_pose.to(self.worker.device), body_shape.to(self.worker.device)
        batches: dict[BodyModel, BodyBatch] = {}
        for index in indices:
            body = self.bodies[index]
            if body not in batches:
                batches[body] = BodyBatch(body, pose, shape if body.origin is None else torch.zeros_like(shape))
            yield Scene(self.grooms[index], batches[body])

    def _objective(
        self, scene: Scene, energy: HairEnergy, loading: Loading, grooms: int, step: int
    ) -> tuple[Tensor, dict[str, float]]:
        """What is descended for one of several grooms, and the loss, Eq. 1 over the batch in `loss_unit`, with the
        energy's terms where this step logs them.

        The gradient is that of the logarithm of each sample's energy above `-ENERGY_OFFSET`: hair pressed into hair
        costs thousands of units before a network is trained, and one groom must not decide a step for all.
        """
        config, unit = self.config, loss_unit(energy)
        draped = self.draper.with_loading(loading).deform(scene, projects=True)
        positions = draped.view_as(draped)
        total = energy.total(positions, scene)
        head = world_from_head(scene.bodies.body, scene.bodies.posed.joint_rotations)[:, None]
        deformation = ((positions - scene.posed) @ head).unflatten(0, (config.runs, config.frames))
        smoothness = energy_pose_regularization(deformation, config.material.k_pose_reg).mean() / config.frames
        metrics = {"loss": float((total.mean() + smoothness).detach()) / unit}
        if self.worker.is_first and ((step + 1) % config.log_every == 0 or step == 0):
            named = energy.by_term(draped.detach(), scene)
            metrics |= {name: float(term.mean()) / unit for name, term in named.items()}
            metrics["pose_regularization"] = float(smoothness.detach()) / unit
        weight = 1 / energy_above_offset(total.detach(), energy)
        # The gradient that arrives is that of the mean over samples and grooms.
        clip_gradients(positions, energy.rest, len(draped) * grooms * unit / weight)
        return ((weight * total).mean() + smoothness) / unit, metrics

    def validate(self, averaged: QuaffureNetwork) -> dict[str, float]:
        """See `validation_metrics`, under `STANDARD_LOADING`."""
        draper = NeuralDraper(averaged, self.config.material, self.config.bf16)
        chosen = range(0, len(self.grooms), -(-len(self.grooms) // VALIDATED_GROOMS))
        scenes = self._scenes(chosen, self.validation.body_pose, self.validation.body_shape)
        return validation_metrics(draper, zip(scenes, (self.energies[index] for index in chosen)))

    def save_weights(
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
        added = "" if self.own_terms is None else f"terms {[term.name for term in self.own_terms]}, "
        digests = dict.fromkeys(map(body_digest, dict.fromkeys(self.bodies)))
        return {
            "identity": f"{names}, {config.network}, {config.material}, {config.elastic}, {added}seed {config.seed}",
            "geometry": f"body {' '.join(digests)}, strands {[len(groom) for groom in self.grooms]}",
        }


def _step_seed(seed: int, rank: int, step: int) -> int:
    """A seed of one step of one worker; any two of them are as good as independent."""
    return int(np.random.SeedSequence((seed, rank, step)).generate_state(1, np.uint64)[0])
