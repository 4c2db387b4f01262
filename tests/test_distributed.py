import json
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest
import torch

from quaffure import InputError
from quaffure.body import BodyModel, load_pose_prior
from quaffure.hair import Groom
from quaffure.training import PoseSampler, Worker
from quaffure.training.distributed import joined_workers
from tests.training_runs import LONGEST_WAIT, QUAFFURE, TINY, checkpoint, rows_of, tiny_groom, train_command, training


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.mark.slow
def test_two_processes_take_the_mean_of_their_gradients(
    body: BodyModel, groom: Groom, tiny_groom_file: Path, tmp_path: Path
) -> None:
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "--no-python"]
    command = [*launcher, QUAFFURE, *train_command(tmp_path / "both", tiny_groom_file, 1)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * LONGEST_WAIT, check=False)
    assert done.returncode == 0, done.stderr

    own = []
    config = replace(TINY, steps=1)
    for rank in range(2):
        run = training(body, groom, tmp_path / f"{rank}", config, Worker(rank))
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


def test_every_step_of_every_process_has_poses_of_its_own(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    drawn: list[torch.Tensor] = []

    class Recording(PoseSampler):
        def sample(self, runs: int, frames: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
            poses, shapes = super().sample(runs, frames, generator)
            drawn.append(poses)
            return poses, shapes

    for rank in range(2):
        run = training(body, groom, tmp_path, TINY, Worker(rank), Recording(load_pose_prior()))
        for _ in islice(run.steps(), 2):
            pass
    apart = torch.cdist(torch.stack(drawn).flatten(1), torch.stack(drawn).flatten(1))
    assert len(drawn) == 4
    assert float((apart + torch.eye(4)).min()) > 0.5


def wait_for_ever(*arguments: object, **options: object) -> None:
    raise AssertionError("waits for workers that nobody started")


@pytest.mark.parametrize(
    ("variables", "complaint"),
    [
        ({"WORLD_SIZE": "2"}, "no .*RANK"),
        ({"WORLD_SIZE": "two"}, "WORLD_SIZE: expected a whole number from 1"),
        ({"WORLD_SIZE": "0"}, "WORLD_SIZE: expected a whole number from 1"),
        ({"WORLD_SIZE": "2", "RANK": "2"}, "RANK: expected a whole number from 0 to 1"),
        ({"WORLD_SIZE": "2", "RANK": "0", "MASTER_PORT": "http"}, "MASTER_PORT"),
    ],
)
def test_an_environment_of_no_launcher_is_refused(
    variables: dict[str, str], complaint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = {"RANK": "0", "LOCAL_RANK": "0", "MASTER_ADDR": "localhost", "MASTER_PORT": "29500"}
    for name, value in ((whole | variables) if "RANK" in variables else variables).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(torch.distributed, "init_process_group", wait_for_ever)
    with pytest.raises(InputError, match=complaint), joined_workers("cpu"):
        pass


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_cuda_without_a_device_is_refused() -> None:
    with pytest.raises(InputError, match="CUDA device"), joined_workers("cuda"):
        pass
    with joined_workers("auto") as worker:
        assert worker == Worker()
