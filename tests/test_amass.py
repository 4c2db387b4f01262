from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.body import BodyModel, Motion, load_body
from quaffure.io import read_amass
from quaffure.io.amass import SMPL_JOINTS

NAMES = [name for name, _ in SMPL_JOINTS]
UPRIGHT = (np.pi / 2, 0.0, 0.0)  # of the pelvis: from SMPL's y up to AMASS's z up, facing -y


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


def written(path: Path, turns: dict[str, tuple[float, float, float]], frames: int = 5, width: int = 156) -> Path:
    poses = np.zeros((frames, width))
    for name, vector in turns.items():
        joint = NAMES.index(name)
        poses[:, 3 * joint : 3 * joint + 3] = vector
    np.savez(path, poses=poses, mocap_framerate=np.array(60.0), trans=np.ones((frames, 3)), gender=np.array("neutral"))
    return path


def bone(motion: Motion, body: BodyModel, joint: str, end: str) -> np.ndarray:
    _, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    vector = joints[0, body.joint_names.index(end)] - joints[0, body.joint_names.index(joint)]
    return torch.nn.functional.normalize(vector, dim=-1).numpy()


def test_upright_t_pose(tmp_path: Path, body: BodyModel) -> None:
    motion = read_amass(written(tmp_path / "t.npz", {"pelvis": UPRIGHT}), body)
    assert (len(motion), motion.fps) == (3, 30.0)
    rotations, _ = body.posed_joints(motion.body_pose, torch.zeros(3, 10))
    for name in ("Hips", "Spine1", "Head", "LeftFoot"):
        assert torch.allclose(rotations[:, body.joint_names.index(name)], torch.eye(3), atol=1e-6)
    np.testing.assert_allclose(bone(motion, body, "LeftArm", "LeftForeArm"), [1, 0, 0], atol=1e-5)
    np.testing.assert_allclose(bone(motion, body, "RightForeArm", "RightHand"), [-1, 0, 0], atol=1e-5)


def test_y_up_files_stand_as_well(tmp_path: Path, body: BodyModel) -> None:
    motion = read_amass(written(tmp_path / "y.npz", {"neck": (0.2, 0, 0)}), body)
    upright = read_amass(written(tmp_path / "z.npz", {"pelvis": UPRIGHT, "neck": (0.2, 0, 0)}), body)
    assert torch.allclose(motion.body_pose, upright.body_pose, atol=1e-6)


@pytest.mark.parametrize(("frames", "width"), [(1, 66), (4, 72), (4, 165)])
def test_any_smpl_width(tmp_path: Path, body: BodyModel, frames: int, width: int) -> None:
    path = written(tmp_path / "wide.npz", {"pelvis": UPRIGHT}, frames, width)
    assert read_amass(path, body).body_pose.shape == ((frames + 1) // 2, 81)


def test_joints_turn_the_way_they_do_in_smpl(tmp_path: Path, body: BodyModel) -> None:
    """About SMPL's y (up): the head to the left. About its x: the left knee folds back."""
    turns = {"pelvis": UPRIGHT, "head": (0, 0.5, 0), "left_knee": (1.0, 0, 0), "left_elbow": (0, -1.2, 0)}
    motion = read_amass(written(tmp_path / "turns.npz", turns), body)
    pose = motion.body_pose[0].unflatten(0, (27, 3))
    np.testing.assert_allclose(pose[body.joint_names.index("Head")].numpy(), [0, 0, 0.5], atol=1e-5)
    np.testing.assert_allclose(pose[body.joint_names.index("LeftLeg")].numpy(), [1.0, 0, 0], atol=1e-5)
    forearm = bone(motion, body, "LeftForeArm", "LeftHand")
    np.testing.assert_allclose(forearm, [np.cos(1.2), -np.sin(1.2), 0], atol=1e-5)


def test_neck_is_half_way(tmp_path: Path, body: BodyModel) -> None:
    motion = read_amass(written(tmp_path / "neck.npz", {"pelvis": UPRIGHT, "neck": (0.4, 0, 0)}), body)
    pose = motion.body_pose[0].unflatten(0, (27, 3))
    for name in ("Neck", "Neck1"):
        np.testing.assert_allclose(pose[body.joint_names.index(name)].numpy(), [0.2, 0, 0], atol=1e-5)


def test_heading_is_kept(tmp_path: Path, body: BodyModel) -> None:
    turned = Rotation.from_rotvec([0, 0, 1.0]) * Rotation.from_rotvec(UPRIGHT)
    motion = read_amass(written(tmp_path / "turned.npz", {"pelvis": tuple(turned.as_rotvec())}), body)
    np.testing.assert_allclose(motion.body_pose[0, :3].numpy(), [0, 0, 1.0], atol=1e-5)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"mocap_framerate": 60.0}, "arrays of numbers poses"),
        ({"poses": np.zeros((4, 63)), "mocap_framerate": 60.0}, r"66 or more\].*\[4, 63\]"),
        ({"poses": np.zeros((0, 66)), "mocap_framerate": 60.0}, "1 to 100000 frames"),
        ({"poses": np.full((4, 66), np.nan), "mocap_framerate": 60.0}, "NaN"),
        ({"poses": np.zeros((4, 66))}, "mocap_frame_rate or fps, found none"),
        ({"poses": np.zeros((4, 66)), "mocap_frame_rate": -1.0}, "above 0 fps"),
        ({"poses": np.array([{}], dtype=object), "mocap_frame_rate": 30.0}, "poses of type object, not plain numbers"),
    ],
)
def test_bad_files(tmp_path: Path, body: BodyModel, arrays: dict[str, np.ndarray], message: str) -> None:
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError, match=message):
        read_amass(tmp_path / "bad.npz", body)
