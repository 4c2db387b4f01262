import math

import pytest
import torch

from quaffure import InputError
from quaffure.body import Motion, filter_flips, joint_matrices, load_body, resample, without_heading
from quaffure.body.motion import AXIAL_JOINTS
from quaffure.geometry import axis_angle_from_matrix, matrix_from_axis_angle

LEFT_ARM, NECK = 10, 14


def turning(frames: int, fps: float, joint: int, rate: float) -> Motion:
    """One joint that turns about a slanted axis at a constant rate [rad/s], from a start that is not the rest."""
    axis = torch.nn.functional.normalize(torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64), dim=0)
    start = matrix_from_axis_angle(torch.tensor([0.3, 0.8, -0.2], dtype=torch.float64))
    turns = matrix_from_axis_angle(rate * torch.arange(frames, dtype=torch.float64)[:, None] / fps * axis)
    pose = torch.zeros(frames, 27, 3)
    pose[:, joint] = axis_angle_from_matrix(start @ turns).float()
    return Motion(pose.flatten(1), fps, "turning")


def angle_between(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return axis_angle_from_matrix(joint_matrices(a).mT @ joint_matrices(b)).norm(dim=-1)


def test_axial_joints_are_the_spine_and_neck_of_the_body() -> None:
    names = load_body().joint_names
    assert {names[i] for i in AXIAL_JOINTS} == {"Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"}


@pytest.mark.parametrize(("old", "new", "frames"), [(120.0, 30.0, 26), (24.0, 30.0, 126), (30.0, 30.0, 101)])
def test_resampling_a_constant_turn_is_exact(old: float, new: float, frames: int) -> None:
    resampled = resample(turning(101, old, LEFT_ARM, 2.0), new)
    assert len(resampled) == frames
    assert resampled.fps == new
    expected = turning(frames, new, LEFT_ARM, 2.0)
    assert angle_between(resampled.body_pose, expected.body_pose).max() < 1e-5


def test_resampling_keeps_the_last_frame_of_rounded_frame_times() -> None:
    motion = turning(121, 1 / 0.00833333, LEFT_ARM, 1.0)
    assert len(resample(motion, 30.0)) == 31


def test_resampling_refuses_absurd_lengths() -> None:
    with pytest.raises(InputError, match="at most 100000 frames"):
        resample(turning(3, 1e-9, LEFT_ARM, 0.0), 30.0)
    with pytest.raises(InputError, match="above 0 fps"):
        resample(turning(3, 30.0, LEFT_ARM, 0.0), 0.0)


@pytest.mark.parametrize("run", [1, 3])
@pytest.mark.parametrize("joint", [LEFT_ARM, NECK])
def test_flips_are_repaired(joint: int, run: int) -> None:
    clean = turning(60, 30.0, joint, 1.5)
    rotations = joint_matrices(clean.body_pose)
    half_turn = matrix_from_axis_angle(torch.tensor([0.0, 3.0, 0.0], dtype=torch.float64))
    rotations[20 : 20 + run, joint] = rotations[20 : 20 + run, joint] @ half_turn
    flipped = Motion(axis_angle_from_matrix(rotations).flatten(1).float(), 30.0, "flipped")
    assert angle_between(flipped.body_pose, clean.body_pose).max() > 2.5
    repaired = filter_flips(flipped)
    assert angle_between(repaired.body_pose, clean.body_pose).max() < 1e-5


def test_fast_motion_and_lasting_jumps_are_left_alone() -> None:
    fast = turning(60, 30.0, LEFT_ARM, 25.0)
    assert angle_between(filter_flips(fast).body_pose, fast.body_pose).max() < 1e-5
    pose = torch.zeros(40, 81)
    pose[20:, 3 * NECK + 2] = 2.0
    cut = Motion(pose, 30.0, "cut")
    assert torch.allclose(filter_flips(cut).body_pose, pose, atol=1e-6)


def test_axis_angles_are_continuous_through_half_a_turn() -> None:
    around = turning(200, 30.0, 0, 0.9)
    jump = around.body_pose.diff(dim=0).norm(dim=-1).max()
    assert jump > 3.0
    smooth = filter_flips(around).body_pose
    assert angle_between(smooth, around.body_pose).max() < 1e-5
    # About one whole turn may be followed without a seam; beyond it one has to come somewhere.
    assert smooth[:150].diff(dim=0).norm(dim=-1).max() < 0.2


def test_frames_slices_and_keeps_time() -> None:
    motion = turning(100, 30.0, LEFT_ARM, 1.0)
    part = motion.frames("10:20:3")
    assert torch.equal(part.body_pose, motion.body_pose[10:20:3])
    assert part.fps == 10.0
    assert len(motion.frames(":")) == 100
    assert len(motion.frames("90:")) == 10
    assert len(motion.frames("::2")) == 50
    assert torch.equal(motion.frames("7").body_pose, motion.body_pose[7:8])


@pytest.mark.parametrize(
    "spec", ["20:10", "10:10", "0:101", "100:", "::0", "a:b", "100", "-5:", "", "1:2:3:4", "0:1.5"]
)
def test_bad_ranges(spec: str) -> None:
    with pytest.raises(InputError, match="frames '"):
        turning(100, 30.0, LEFT_ARM, 1.0).frames(spec)


def test_motion_refuses_bad_poses() -> None:
    with pytest.raises(InputError, match="81"):
        Motion(torch.zeros(3, 80), 30.0, "narrow")
    with pytest.raises(InputError, match="81"):
        Motion(torch.zeros(0, 81), 30.0, "empty")
    with pytest.raises(InputError, match="NaN"):
        Motion(torch.full((1, 81), math.nan), 30.0, "hollow")
    with pytest.raises(InputError, match="frame rate"):
        Motion(torch.zeros(1, 81), 0.0, "frozen")


def test_heading_is_removed_and_tilt_kept() -> None:
    body, shape = load_body(), torch.zeros(1, 10)
    tilt = matrix_from_axis_angle(torch.tensor([0.4, -0.3, 0.0]))
    turn = matrix_from_axis_angle(torch.tensor([0.0, 0.0, 2.5]))
    pose = torch.zeros(1, 81)
    pose[0, :3] = axis_angle_from_matrix(turn @ tilt)
    pose[0, 3 * NECK] = 0.5
    expected = pose.clone()
    expected[0, :3] = torch.tensor([0.4, -0.3, 0.0])
    plain = without_heading(pose)
    assert torch.allclose(plain, expected, atol=1e-6)
    up_before = body.posed_joints(pose, shape)[0][0, 16, 2]
    assert torch.allclose(body.posed_joints(plain, shape)[0][0, 16, 2], up_before, atol=1e-6)
