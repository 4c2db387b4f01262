import json

import numpy as np
import pytest
import torch

from quaffure.benchmark import load_evaluation_set
from quaffure.benchmark.evaluation_set import SETS
from quaffure.body import PRIOR_FILE, BodyModel, PosePrior, joint_matrices, load_body, load_pose_prior, without_heading
from quaffure.geometry import axis_angle_from_matrix, matrix_from_axis_angle
from scripts.fit_pose_prior import check_prior


@pytest.fixture(scope="module")
def prior() -> PosePrior:
    return load_pose_prior()


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(3)


def offsets_from_mean(pose: torch.Tensor, prior: PosePrior) -> torch.Tensor:
    mean = matrix_from_axis_angle(prior.mean_pose.double().unflatten(-1, (27, 3)))
    return axis_angle_from_matrix(mean.mT @ joint_matrices(pose)).flatten(-2)


def test_the_shipped_prior_is_small_sound_and_blind_to_the_evaluation_clips(prior: PosePrior) -> None:
    check_prior(prior, str(PRIOR_FILE))
    assert PRIOR_FILE.stat().st_size <= 300_000
    held_out = {name for version in SETS for name in load_evaluation_set(version).motions}
    assert sorted(held_out) == ["02_04", "05_04", "05_11", "07_01", "09_05", "13_26"]
    with np.load(PRIOR_FILE, allow_pickle=False) as arrays:
        clips = json.loads(str(arrays["meta"]))["clips"]
    assert len(clips) >= 8
    assert not set(clips) & held_out


def test_samples_stay_within_the_observed_ranges(prior: PosePrior, generator: torch.Generator) -> None:
    offsets = offsets_from_mean(prior.sample(500, generator), prior)
    assert (offsets >= prior.quantiles[0] - 1e-4).all()
    assert (offsets <= prior.quantiles[-1] + 1e-4).all()
    # Not the mean 500 times: half of the samples lie outside the middle half of each table that moves.
    low, high = prior.quantiles[19], prior.quantiles[33]
    moving = prior.quantiles[-1] - prior.quantiles[0] > 0.05
    outside = ((offsets < low) | (offsets > high)).double().mean(0)[moving]
    assert (outside - 0.484).abs().max() < 0.1


def test_heads_turn_as_far_as_people_can(prior: PosePrior, body: BodyModel, generator: torch.Generator) -> None:
    pose = prior.sample(2000, generator)
    rotations = body.posed_joints(pose, torch.zeros(len(pose), 10))[0]
    head, chest = (rotations[:, body.joint_names.index(name)] for name in ("Head", "Spine1"))
    forward = (chest.mT @ head)[..., 1]
    turn = torch.rad2deg(torch.atan2(-forward[:, 0], forward[:, 1]))
    for share in (turn > 45, turn < -45):
        assert 0.08 < share.double().mean() < 0.25
    # Seen from above, a head that also leans looks further round than it turned.
    assert 60 < turn.abs().max() < 90


def test_elbows_bend_forward_only(prior: PosePrior, body: BodyModel, generator: torch.Generator) -> None:
    rotations = joint_matrices(prior.sample(500, generator))
    for side in ("Left", "Right"):
        hand, elbow = (body.joint_names.index(f"{side}{end}") for end in ("Hand", "ForeArm"))
        bone = torch.nn.functional.normalize(body.rest_joints[hand] - body.rest_joints[elbow], dim=-1).double()
        assert (rotations[:, elbow] @ bone)[:, 1].max() < 0.35


def test_seeds_decide_and_heading_is_zero(prior: PosePrior) -> None:
    first, again = (prior.sample(4, torch.Generator().manual_seed(5)) for _ in range(2))
    assert torch.equal(first, again)
    assert not torch.equal(first, prior.sample(4, torch.Generator().manual_seed(6)))
    hips = first[:, :3] - without_heading(first)[:, :3]
    assert hips.abs().max() < 0.02


def test_sequences_are_smooth_at_any_rate(prior: PosePrior, generator: torch.Generator) -> None:
    for fps in (30.0, 120.0):
        motion = prior.sample_sequences(16, 40, fps, generator)
        assert motion.shape == (16, 40, 81)
        rotations = joint_matrices(motion.flatten(0, 1)).unflatten(0, (16, 40))
        speed = axis_angle_from_matrix(rotations[:, :-1].mT @ rotations[:, 1:]).norm(dim=-1) * fps
        assert speed.max() < 35  # rad/s, a fast strike
        # Limbs move about as fast as people's, whatever the frame rate.
        assert 0.5 < speed[..., 10].square().mean().sqrt() < 6


def test_each_frame_of_a_sequence_is_distributed_as_a_sample(prior: PosePrior, generator: torch.Generator) -> None:
    poses = prior.sample(3000, generator)
    last = prior.sample_sequences(3000, 12, 10.0, generator)[:, -1]
    spread = offsets_from_mean(poses, prior).std(0)
    moving = spread > 0.02
    ratio = offsets_from_mean(last, prior).std(0)[moving] / spread[moving]
    assert (ratio - 1).abs().max() < 0.1


def test_one_frame_is_a_sequence(prior: PosePrior, generator: torch.Generator) -> None:
    assert prior.sample_sequences(2, 1, 30.0, generator).shape == (2, 1, 81)
