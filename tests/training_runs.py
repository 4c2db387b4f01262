"""Small training runs that many tests share."""

import csv
import sys
from pathlib import Path
from typing import TypeVar

import torch
from torch import nn

from quaffure.body import FEATURE_COUNT, BodyModel, load_pose_prior
from quaffure.hair import Groom
from quaffure.model import NetworkConfig
from quaffure.procedural import make_groom
from quaffure.training import DecoderRecipe, GroomedBody, PoseSampler, TrainConfig, Training, Validation, Worker
from quaffure.training.distributed import SINGLE_PROCESS

TINY = TrainConfig(
    network=NetworkConfig(pose_features=FEATURE_COUNT, texel_channels=8, strand_width=16),
    steps=4,
    runs=1,
    warmup=2,
    log_every=1,
    validate_every=2,
)
TINY_OPTIONS = (
    *("--texel-channels", "8", "--strand-width", "16", "--runs", "1", "--warmup", "2"),
    *("--log-every", "1", "--validate-every", "100", "--save-every-seconds", "0", "--device", "cpu"),
)
QUAFFURE = Path(sys.executable).with_name("quaffure")
LONGEST_WAIT = 300  # seconds

Network = TypeVar("Network", bound=nn.Module)


def tiny_groom(body: BodyModel) -> Groom:
    return make_groom("bob", body).select(torch.arange(0, 2400, 60))


def perturbed(network: Network, strength: float = 0.06) -> Network:
    """With noise on all weights, as if it had learnt something: the last layer of a new network is zero."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += strength * torch.randn_like(parameter)
    return network.eval()


def validation() -> Validation:
    return Validation(*PoseSampler(load_pose_prior()).sample(2, 1, torch.Generator().manual_seed(9)))


def training(
    body: BodyModel,
    groom: Groom | tuple[Groom, ...],
    folder: Path,
    config: TrainConfig = TINY,
    worker: Worker = SINGLE_PROCESS,
    sampler: PoseSampler | None = None,
) -> Training[DecoderRecipe]:
    """A run on one groom or several, with poses of the shipped prior."""
    grooms = groom if isinstance(groom, tuple) else (groom,)
    sampler = sampler or PoseSampler(load_pose_prior())
    return Training(DecoderRecipe(config, (GroomedBody(body, grooms),), sampler, validation(), worker), folder)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def checkpoint(folder: Path) -> dict:
    state: dict = torch.load(folder / "checkpoint.pt", weights_only=True)
    return state


def train_command(folder: Path, groom_file: Path, steps: int) -> list[str]:
    return ["train", "--out", str(folder), "--groom", str(groom_file), "--steps", str(steps), *TINY_OPTIONS]
