"""`quaffure train`: train a network on given grooms, by physics alone."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro

from quaffure.apps.cli.console import console, run_training
from quaffure.apps.cli.inputs import motion_of
from quaffure.benchmark.evaluation_set import refuse_evaluation_data
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.head_frame_kernels import FEATURE_COUNT
from quaffure.body.pose_prior import load_pose_prior
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output_folder
from quaffure.model.checkpoint import load_network
from quaffure.model.quaffure_model import WEIGHTS
from quaffure.model.quaffure_network import QuaffureNetwork
from quaffure.procedural.hair_style import HELD_OUT, STYLES
from quaffure.training.distributed import Device, joined_workers
from quaffure.training.groom_samples import family_grooms
from quaffure.training.loop import BEST, LAST, Training
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.run_folder import RUN
from quaffure.training.train_config import TrainConfig
from quaffure.training.train_decoder import DecoderRecipe, GroomedBody
from quaffure.training.validation import prior_validation

SHIPPED = "shipped"
MOST_STYLES = 10_000
"""Limit of `--family`; all of its grooms are made at the start and kept."""
"""Name of the weights and of the body in the package."""


@dataclass(frozen=True)
class TrainCommand:
    """Train a network on grooms over sampled poses and shapes; continues where an earlier run in the folder stopped.

    With --body and --weights it specialises a network on a character, whose shape stays its own.

    Poses come from the shipped prior, and from motion files if some are given. The folder then holds
    `best.safetensors`, the weights to drape with (`quaffure drape --weights`), `last.safetensors`, the newest ones,
    `config.json`, the tables `training.csv` and `validation.csv`, and the checkpoint to continue from. Ctrl-C and
    SIGTERM end the step and leave all of them. Several processes share a run when a
    launcher starts them: `torchrun --nproc-per-node 2 --no-python quaffure train ...`.
    """

    out: Path
    """Folder of the run; made if it does not exist."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled groom or a file; may be given several times. Grooms that are held out for evaluation are refused.
    Without --groom and --family: all bundled ones that are not held out."""
    family: int = 0
    """Samples of the continuous family of hairstyles to train on, in addition or instead."""
    motion: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """Motion files to train on with the pose prior; may be given several times. Evaluation clips are refused."""
    body: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """`shipped`, the default, or a body file (.npz): that of a character (`quaffure body import`), which bundled grooms
    are moved to, or one that a script made (`scripts/vary_body.py`). May be given several times: every groom is trained
    on each."""
    weights: str | None = None
    """Weights to start from: a file, or `shipped`. The options of the network are then those of the weights."""
    device: Device = "auto"
    """`auto` is CUDA if there is a device, else the CPU."""
    config: TrainConfig = field(default_factory=TrainConfig)

    def run(self) -> None:
        self._check()
        with joined_workers(self.device) as worker:
            started = self._weights()
            config = self.config if started is None else replace(self.config, network=started.config)
            bodies = [_body(name) for name in self.body or (SHIPPED,)]
            sampler = self._sampler(bodies[0])
            if worker.is_first:
                console.print("reading the grooms")
            groomed = tuple(GroomedBody(body, self._grooms(body)) for body in bodies)
            recipe = DecoderRecipe(config, groomed, sampler, prior_validation(), worker)
            run_training(Training(recipe, self.out), _bar_text, _validation_text, start=started)

    def _check(self) -> None:
        """Refuse options that are wrong whatever the files hold."""
        check_output_folder(self.out, RUN, (BEST, LAST), (self.weights,))
        pose_features = self.config.network.pose_features
        if pose_features not in (0, FEATURE_COUNT):
            raise InputError("--pose-features", f"0 or {FEATURE_COUNT}", f"{pose_features}")
        if not 0 <= self.family <= MOST_STYLES:
            raise InputError("--family", f"0 to {MOST_STYLES}", f"{self.family}")
        refuse_evaluation_data(self.groom, self.motion)

    @property
    def _groom_names(self) -> tuple[str, ...]:
        return self.groom or (() if self.family else tuple(name for name in STYLES if name not in HELD_OUT))

    def _grooms(self, body: BodyModel) -> tuple[Groom, ...]:
        own = [load_groom(name, body) for name in self._groom_names]
        # The name of a groom is in its file, whatever the name of the file.
        refuse_evaluation_data(groom.name for groom in own)
        return (*own, *(family.groom(body) for family in family_grooms(range(self.family))))

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


def _body(name: str) -> BodyModel:
    body, shipped = load_body(None if name == SHIPPED else name), load_body()
    if body.joint_names != shipped.joint_names:
        # The pose prior, the clips and the pose features are indexed by joint.
        raise InputError(name, f"the joints {list(shipped.joint_names)}", f"{list(body.joint_names)}")
    return body


def _bar_text(values: dict[str, float]) -> str:
    return f"loss {values['loss']:.3f}, {values['samples_per_second']:.0f} samples/s"


def _validation_text(values: dict[str, float]) -> str:
    if "energy" not in values:
        return ""
    inside, rotated = values["body_intersection_percent"], values["orientation_error_deg"]
    return f"energy {values['energy']:.4f}, {inside:.2f} % inside the body, {rotated:.1f} deg from the posed groom"
