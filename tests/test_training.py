from dataclasses import replace
from pathlib import Path

import pytest
import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.clips import bundled_clip
from quaffure.body.motion import Motion
from quaffure.body.pose_features import FEATURE_COUNT
from quaffure.body.pose_prior import load_pose_prior
from quaffure.errors import InputError
from quaffure.groom.groom import Groom
from quaffure.groom.procedural import make_groom
from quaffure.networks.checkpoint import load_network
from quaffure.networks.quaffure_network import NetworkConfig
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.train_decoder import DecoderTraining, TrainConfig, Validation, train

TINY = TrainConfig(
    network=NetworkConfig(pose_features=FEATURE_COUNT, texel_channels=8, strand_width=16),
    steps=12,
    runs=2,
    warmup=2,
    validate_every=6,
    save_every_seconds=0,
)


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom("bob", body).select(torch.arange(0, 2400, 60))


def training(body: BodyModel, groom: Groom, folder: Path, config: TrainConfig = TINY) -> DecoderTraining:
    return DecoderTraining(config, body, (groom,), PoseSampler(load_pose_prior()), folder)


def validation() -> Validation:
    return Validation(*PoseSampler(load_pose_prior()).sample(2, 1, torch.Generator().manual_seed(9)))


class SamePoses(PoseSampler):
    """Two frames of a turning head, every time."""

    def sample(self, runs: int, frames: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        pose = bundled_clip("neck_turn", load_body()).body_pose[[20, 65]]
        return pose.repeat(runs, 1), torch.zeros(2 * runs, 10)


@pytest.mark.parametrize("output", ["directions", "displacement"])
def test_steps_on_the_same_poses_lower_the_loss(body: BodyModel, tmp_path: Path, output: str) -> None:
    groom = make_groom("long_straight", body).select(torch.arange(0, 2400, 60))
    network = replace(TINY.network, output=output)
    config = replace(TINY, network=network, steps=40, runs=1, learning_rate=2e-3)
    run = DecoderTraining(config, body, (groom,), SamePoses(load_pose_prior()), tmp_path)
    losses = [figures["loss"] for figures in run.steps()]
    assert min(losses[-5:]) < 0.8 * losses[0]


def test_a_killed_run_carries_on_to_the_same_weights(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    train(training(body, groom, whole), validation(), lambda step, figures: None)

    def stop_at_seven(step: int, figures: dict[str, float]) -> None:
        if step == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(training(body, groom, killed), validation(), stop_at_seven)
    again = training(body, groom, killed)
    assert again.resume()
    assert again.step == 6
    train(again, validation(), lambda step, figures: None)
    weights = [torch.load(folder / "checkpoint.pt", weights_only=True)["network"] for folder in (whole, killed)]
    for name, value in weights[0].items():
        torch.testing.assert_close(weights[1][name], value, atol=1e-6, rtol=1e-4, msg=name)


def test_the_best_weights_and_the_log_are_kept(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    run = training(body, groom, tmp_path)
    train(run, validation(), lambda step, figures: None)
    _, material, notes = load_network(tmp_path / "best.safetensors")
    assert material == TINY.material
    assert notes["grooms"] == "bob"
    rows = (tmp_path / "validation.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", "6", "12"]
    assert {path.name for path in tmp_path.iterdir()} == {
        "best.safetensors", "checkpoint.pt", "config.json", "validation.csv"
    }  # fmt: skip


def test_the_regularization_of_poses_reaches_the_network(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    losses = []
    for strength in (0.0, 10.0):
        material = replace(TINY.material, k_pose_reg=strength)
        losses.append(next(training(body, groom, tmp_path, replace(TINY, material=material)).steps())["loss"])
    assert losses[1] > losses[0] + 1e-6


def test_runs_are_consecutive_frames_of_one_body() -> None:
    clip = Motion(torch.arange(20.0)[:, None].expand(-1, 81) / 100, 30.0, "count")
    sampler = PoseSampler(load_pose_prior(), (clip,), clip_share=1.0)
    pose, shape = sampler.sample(5, 3, torch.Generator().manual_seed(0))
    steps = pose.reshape(5, 3, 81).diff(dim=1)
    torch.testing.assert_close(steps, torch.full_like(steps, 0.01), atol=1e-6, rtol=0)
    assert len({round(float(start), 3) for start in pose[::3, 0]}) > 1
    assert torch.equal(shape[0], shape[2])
    assert not torch.equal(shape[0], shape[3])


def test_a_folder_of_another_run_is_refused(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    training(body, groom, tmp_path).save()
    with pytest.raises(InputError, match="seed 1"):
        training(body, groom, tmp_path, replace(TINY, seed=1)).resume()
    (tmp_path / "checkpoint.pt").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(InputError, match="checkpoint"):
        training(body, groom, tmp_path).resume()


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="validate-every"):
        TrainConfig(validate_every=0)
