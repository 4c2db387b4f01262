import csv
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.resources import files
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.clips import bundled_clip
from quaffure.body.motion import Motion
from quaffure.body.pose_features import FEATURE_COUNT
from quaffure.body.pose_prior import load_pose_prior
from quaffure.cli.main import main
from quaffure.config import HairMaterial
from quaffure.drapers.neural import NeuralDraper
from quaffure.drapers.scene import BodyBatch, Scene
from quaffure.energies.hair_energy import HairEnergy
from quaffure.errors import InputError
from quaffure.groom.groom import Groom
from quaffure.groom.hair_style import HELD_OUT
from quaffure.groom.procedural import make_groom
from quaffure.io.groom_file import write_groom
from quaffure.networks.checkpoint import load_network
from quaffure.networks.quaffure_network import NetworkConfig, build_network
from quaffure.training.averaged_adam import AveragedAdam
from quaffure.training.distributed import Worker, joined_workers
from quaffure.training.pose_sampler import PoseSampler
from quaffure.training.train_config import TrainConfig
from quaffure.training.train_decoder import DecoderTraining, train
from quaffure.training.validation import Validation, validation_figures

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


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom("bob", body).select(torch.arange(0, 2400, 60))


@pytest.fixture(scope="module")
def groom_file(groom: Groom, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grooms") / "tiny.npz"
    write_groom(path, groom)
    return path


def training(body: BodyModel, groom: Groom, folder: Path, config: TrainConfig = TINY, rank: int = 0) -> DecoderTraining:
    return DecoderTraining(config, body, (groom,), PoseSampler(load_pose_prior()), folder, Worker(rank))


def validation() -> Validation:
    return Validation(*PoseSampler(load_pose_prior()).sample(2, 1, torch.Generator().manual_seed(9)))


def silent(step: int, figures: dict[str, float]) -> None:
    pass


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def checkpoint(folder: Path) -> dict:
    state: dict = torch.load(folder / "checkpoint.pt", weights_only=True)
    return state


def train_command(folder: Path, groom_file: Path, steps: int) -> list[str]:
    return ["train", "--out", str(folder), "--groom", str(groom_file), "--steps", str(steps), *TINY_OPTIONS]


class SamePoses(PoseSampler):
    """Two frames of a turning head, every time."""

    def sample(self, runs: int, frames: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        pose = bundled_clip("neck_turn", load_body()).body_pose[[20, 65]]
        return pose.repeat(runs, 1), torch.zeros(2 * runs, 10)


@pytest.mark.parametrize("output", ["directions", "displacement"])
def test_steps_on_the_same_poses_lower_the_loss(body: BodyModel, tmp_path: Path, output: str) -> None:
    groom = make_groom("long_straight", body).select(torch.arange(0, 2400, 60))
    network = replace(TINY.network, output=output)
    config = replace(TINY, network=network, steps=24, log_every=24, learning_rate=2e-3)
    run = DecoderTraining(config, body, (groom,), SamePoses(load_pose_prior()), tmp_path)
    losses = [figures["loss"] for figures in islice(run.steps(), 12)]
    assert min(losses[-5:]) < 0.6 * losses[0]


def test_two_runs_end_with_the_same_bits(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    weights = []
    for seed in (0, 0, 1):
        run = training(body, groom, tmp_path, replace(TINY, steps=2, seed=seed))
        for _ in run.steps():
            pass
        weights.append(run.draper.network.state_dict())
    for name, value in weights[0].items():
        assert torch.equal(weights[1][name], value), name
    assert any(not torch.equal(weights[2][name], value) for name, value in weights[0].items())


def test_every_step_of_every_process_has_poses_of_its_own(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    drawn: list[torch.Tensor] = []

    class Recording(PoseSampler):
        def sample(self, runs: int, frames: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
            poses, shapes = super().sample(runs, frames, generator)
            drawn.append(poses)
            return poses, shapes

    for rank in range(2):
        run = DecoderTraining(TINY, body, (groom,), Recording(load_pose_prior()), tmp_path, Worker(rank))
        for _ in islice(run.steps(), 2):
            pass
    apart = torch.cdist(torch.stack(drawn).flatten(1), torch.stack(drawn).flatten(1))
    assert len(drawn) == 4
    assert float((apart + torch.eye(4)).min()) > 0.5


def test_a_killed_run_ends_like_an_unbroken_one_bit_for_bit(groom_file: Path, tmp_path: Path) -> None:
    steps, killed = 6, tmp_path / "killed"
    process = subprocess.Popen([QUAFFURE, *train_command(killed, groom_file, steps)], stdout=subprocess.DEVNULL)
    log, end = killed / "training.csv", time.monotonic() + LONGEST_WAIT
    try:
        while not (log.is_file() and len(rows_of(log)) >= 2):
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.01)
    finally:
        process.kill()
    assert process.wait() == -signal.SIGKILL
    reached = checkpoint(killed)["counters"][0]
    assert 1 <= reached < steps

    main(train_command(killed, groom_file, steps))
    main(train_command(tmp_path / "whole", groom_file, steps))
    resumed, whole = checkpoint(killed), checkpoint(tmp_path / "whole")
    for part in ("network", "average"):
        for name, value in whole[part].items():
            assert torch.equal(resumed[part][name], value), name
    assert torch.equal(resumed["counters"][:2], whole["counters"][:2])
    assert [row["loss"] for row in rows_of(log)] == [row["loss"] for row in rows_of(tmp_path / "whole/training.csv")]


def test_two_processes_take_the_mean_of_their_gradients(
    body: BodyModel, groom: Groom, groom_file: Path, tmp_path: Path
) -> None:
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "--no-python"]
    command = [*launcher, QUAFFURE, *train_command(tmp_path / "both", groom_file, 1)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * LONGEST_WAIT, check=False)
    assert done.returncode == 0, done.stderr

    own = []
    config = replace(TINY, steps=1)
    for rank in range(2):
        run = training(body, groom, tmp_path / f"{rank}", config, rank)
        norm = next(run.steps())["gradient_norm"]
        own.append([moment / 0.1 * max(1.0, norm) for moment in first_moments(run.optimizer.adam.state_dict())])
    mean = [(first + second) / 2 for first, second in zip(*own)]
    norm = float(torch.stack([gradient.norm() for gradient in mean]).norm())
    for found, gradient in zip(first_moments(checkpoint(tmp_path / "both")["optimizer"]), mean, strict=True):
        torch.testing.assert_close(found, 0.1 * gradient / max(1.0, norm), rtol=1e-3, atol=1e-7)
    assert float((own[0][-1] - own[1][-1]).norm()) > 0.1 * float(own[0][-1].norm())  # each had poses of its own

    (row,) = rows_of(tmp_path / "both" / "training.csv")  # one of them writes
    assert float(row["gradient_norm"]) == pytest.approx(norm, rel=1e-4)
    assert json.loads((tmp_path / "both" / "config.json").read_text())["processes"] == 2


def first_moments(optimizer: dict) -> list[torch.Tensor]:
    """Adam's running means of the gradients, after one step a tenth of the first ones."""
    return [state["exp_avg"] for _, state in sorted(optimizer["state"].items())]


def test_a_run_leaves_configuration_logs_and_the_best_weights(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    reports: list[dict[str, float]] = []
    train(training(body, groom, tmp_path), validation(), lambda step, figures: reports.append(figures))
    _, material, notes = load_network(tmp_path / "best.safetensors")
    assert material == TINY.material
    assert notes["grooms"] == "bob"
    assert {path.name for path in tmp_path.iterdir()} == {
        "best.safetensors", "checkpoint.pt", "config.json", "training.csv", "validation.csv"
    }  # fmt: skip
    rows = rows_of(tmp_path / "validation.csv")
    assert [row["step"] for row in rows] == ["2", "4"]
    assert float(rows[1]["body_intersection_percent"]) == pytest.approx(
        reports[3]["body_intersection_percent"], rel=1e-5
    )
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["config"]["network"]["strand_width"] == 16
    assert config["grooms"] == [{"name": "bob", "strands": 40}]


def test_the_log_holds_every_term_of_the_loss(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    train(training(body, groom, tmp_path, replace(TINY, log_every=2)), validation(), silent)
    rows = rows_of(tmp_path / "training.csv")
    assert [row["step"] for row in rows] == ["2", "4"]
    terms = ("stretch_shear", "stretch", "gravity", "body_collision", "self_collision", "pose_regularization")
    for row in rows:
        values = [float(row[name]) for name in terms]
        # Strands that slide along the body from the start may touch nothing.
        assert all(value != 0 for name, value in zip(terms, values) if name != "body_collision")
        assert sum(values) == pytest.approx(float(row["loss"]), rel=1e-4)
    assert float(rows[0]["learning_rate"]) > float(rows[1]["learning_rate"]) > 0


def test_validation_tells_the_share_of_vertices_inside(body: BodyModel, groom: Groom) -> None:
    class QuarterInside(NeuralDraper):
        """Strands a hundredth of their size: every fourth one in the middle of the head, the others above it."""

        def drape(self, scene: Scene) -> torch.Tensor:
            head = scene.bodies.posed.joint_positions[:, body.joint_names.index("Head"), None, None]
            places = torch.tensor([0.0, -0.02, 0.1]).repeat(len(groom), 1, 1)
            places[torch.arange(len(groom)) % 4 > 0] += torch.tensor([0.0, 0.0, 1.0])
            return head + places + 0.01 * (scene.posed - scene.posed[:, :, :1])

    scene = Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))
    draper = QuarterInside(build_network(TINY.network), HairMaterial())
    figures = validation_figures(draper, [(scene, HairEnergy(groom, HairMaterial()))])
    assert figures["body_intersection_percent"] == pytest.approx(25)
    assert figures["length_error_percent"] == pytest.approx(99, abs=0.1)
    assert figures["orientation_error_deg"] < 0.1


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


def test_weights_to_start_from_are_those_of_both_networks(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    run = training(body, groom, tmp_path, replace(TINY, learning_rate=1e-9))
    given = build_network(TINY.network)
    run.start_from(given)
    next(run.steps())
    for network in (run.draper.network, run.optimizer.averaged):
        for name, value in given.state_dict().items():
            torch.testing.assert_close(network.state_dict()[name], value, atol=1e-7, rtol=1e-5)
    with pytest.raises(InputError, match="other layers"):
        run.start_from(build_network(replace(TINY.network, strand_width=8)))


def test_a_folder_of_another_run_is_refused(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    training(body, groom, tmp_path).save()
    with pytest.raises(InputError, match="seed 1"):
        training(body, groom, tmp_path, replace(TINY, seed=1)).resume()
    with pytest.raises(InputError, match=r"strands \[20\]"):
        training(body, groom.select(torch.arange(20)), tmp_path).resume()
    other = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    other["network"]["of_another_version"] = torch.zeros(1)
    torch.save(other, tmp_path / "checkpoint.pt")
    with pytest.raises(InputError, match="checkpoint of this training"):
        training(body, groom, tmp_path).resume()


def test_a_gradient_that_is_not_finite_changes_no_weight() -> None:
    layer = torch.nn.Linear(2, 1)
    optimizer = AveragedAdam(layer, 0.1, 0.9)
    before = layer.weight.detach().clone()
    (layer(torch.ones(2)) * float("inf")).sum().backward()
    with pytest.raises(InputError, match="learning-rate"):
        optimizer.update(1.0)
    assert torch.equal(layer.weight, before)


def test_the_command_trains_on_a_body_of_ones_own(
    groom_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(str(files("quaffure") / "assets" / "body.npz"), allow_pickle=False) as shipped:
        arrays = dict(shipped)
    arrays["rest_vertices"] = arrays["rest_vertices"] + np.float32([0, 0, 1e-3])
    np.savez(tmp_path / "taller.npz", **arrays)
    command = train_command(tmp_path / "run", groom_file, 1)
    main([*command, "--body", str(tmp_path / "taller.npz")])
    load_network(tmp_path / "run" / "best.safetensors")
    with pytest.raises(SystemExit) as stop:
        main(command)
    assert stop.value.code == 2
    assert "expected a run on body" in capsys.readouterr().err

    arrays["joint_names"] = arrays["joint_names"][::-1]
    np.savez(tmp_path / "reversed.npz", **arrays)
    with pytest.raises(SystemExit):
        main([*command, "--body", str(tmp_path / "reversed.npz")])
    assert "the joints" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--groom", HELD_OUT[0]], "held out"),
        (["--groom", "bob", "--pose-features", "5"], "0 or 111"),
        (["--groom", "bob", "--weights", "none.safetensors"], "no such file"),
    ],
)
def test_what_cannot_be_trained_is_refused_in_one_line(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["train", "--out", str(tmp_path / "run"), *options])
    assert stop.value.code == 2
    told = capsys.readouterr().err
    assert complaint in told
    assert told.count("\n") == 1


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="validate-every"):
        TrainConfig(validate_every=0)


def test_an_environment_of_no_launcher_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.delenv("RANK", raising=False)
    with pytest.raises(InputError, match="RANK"), joined_workers("cpu"):
        pass


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_cuda_without_a_device_is_refused() -> None:
    with pytest.raises(InputError, match="CUDA device"), joined_workers("cuda"):
        pass
    with joined_workers("auto") as worker:
        assert worker == Worker()


@pytest.mark.cuda
def test_a_step_on_cuda_has_the_loss_of_one_on_the_cpu(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    sampler = PoseSampler(load_pose_prior())
    losses = []
    for device in ("cpu", "cuda"):
        run = DecoderTraining(TINY, body, (groom,), sampler, tmp_path, Worker(device=torch.device(device)))
        losses.append([figures["loss"] for figures in run.steps()])
    assert losses[1] == pytest.approx(losses[0], rel=1e-2)
