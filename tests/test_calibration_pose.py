"""Calibration poses at the start of motions, and what commands print about them."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import load_motion
from quaffure.apps.cli.main import main
from quaffure.body import CLIP_NAMES, BodyModel, Motion
from quaffure.body.calibration_pose import calibration_pose
from quaffure.body.retargeting import align_bone, body_bone, local_pose

ARMS_DOWN = 1.2  # rad


def standing(body: BodyModel, sink: float, bend: float = 0.0) -> torch.Tensor:
    """Pose with arms that point so far below the level, with elbows bent by so much [rad]."""
    world = {}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for joint, end, angle in (("Arm", "ForeArm", sink), ("ForeArm", "Hand", sink + bend)):
            towards = torch.tensor([sign * np.cos(angle), 0.0, -np.sin(angle)])
            world[side + joint] = align_bone(body_bone(body, side + joint, side + end), towards)[None]
    return local_pose(world, body)


def starting(body: BodyModel, frames: int, first: torch.Tensor | None = None) -> Motion:
    """So many frames of a pose, a T pose without one, and then a second in which a body with low arms turns."""
    pose = standing(body, ARMS_DOWN).repeat(frames + 30, 1)
    pose[frames:, 2] = torch.linspace(0, 0.3, 30)
    pose[:frames] = standing(body, 0.0) if first is None else first
    return Motion(pose, 30.0, "clip")


@pytest.mark.parametrize("frames", [1, 4])
def test_a_t_pose_before_the_motion_is_found(body: BodyModel, frames: int) -> None:
    found = calibration_pose(starting(body, frames), body)
    assert found is not None
    assert (found.frames, found.is_t_pose) == (frames, True)
    assert found.jump == pytest.approx(ARMS_DOWN, abs=0.02)
    assert f"out with --frames '{frames}:'" in str(found)
    assert calibration_pose(starting(body, frames).frames(f"{frames}:"), body) is None


def test_the_rest_pose_of_the_body_is_found_and_is_no_t_pose(body: BodyModel) -> None:
    found = calibration_pose(starting(body, 1, torch.zeros(81)), body)
    assert found is not None
    assert "the first frame stands in the rest pose of the body, " in str(found)


def test_other_beginnings_are_none(body: BodyModel) -> None:
    assert calibration_pose(starting(body, 1, standing(body, 0.0, bend=1.0)), body) is None
    assert calibration_pose(starting(body, 45), body) is None  # a cut in the middle of a motion
    still = Motion(torch.zeros(1, 81), 30.0, "one frame")
    assert calibration_pose(still, body) is None
    fast = starting(body, 1)
    kick = fast.body_pose.clone()
    kick[1:, 3 * body.joint_names.index("LeftUpLeg")] += torch.arange(30.0) % 6
    assert calibration_pose(Motion(kick, 30.0, "kicks"), body) is None
    assert [name for name in CLIP_NAMES if calibration_pose(load_motion(name, body), body)] == []


@pytest.mark.slow
@pytest.mark.shared_data
def test_real_motion_has_it_where_it_begins_with_one(body: BodyModel, shared_data: Path) -> None:
    files = sorted([*shared_data.glob("motion*/*.bvh"), *shared_data.glob("rigs/*.bvh")])
    assert len(files) > 10
    found = {path.stem: calibration_pose(load_motion(path, body), body) for path in files}
    t_poses = {name: (pose.frames, pose.is_t_pose) for name, pose in found.items() if pose is not None}
    assert t_poses == {"cmu_original_names_12_01": (1, True), "xsens_like": (1, True)}


def test_commands_print_it(
    tmp_path: Path, body: BodyModel, tiny_groom_file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "captured.npz"
    np.savez(path, body_pose=starting(body, 1).body_pose.numpy(), fps=30.0)
    main(["inspect", str(path), "--json"])
    (note,) = json.loads(capfd.readouterr().out)["notes"]
    assert note.startswith("the first frame stands in a T pose, ")
    assert note.endswith("as for a calibration; leave it out with --frames '1:'")
    drape = [
        "drape",
        str(tiny_groom_file),
        "--draper",
        "posed",
        "--motion",
        str(path),
        "--out",
        str(tmp_path / "x.npz"),
    ]
    main([*drape, "--frames", "0:3"])
    assert f"{path}: {note}" in capfd.readouterr().out.splitlines()
    main([*drape, "--frames", "1:3"])
    assert "calibration" not in capfd.readouterr().out
