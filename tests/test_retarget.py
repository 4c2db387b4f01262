from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.body import BodyModel, BvhClip, Motion, load_body, retarget_bvh
from quaffure.io import read_bvh
from quaffure.io.read_motion import read_motion

CHANNELS = ("Zrotation", "Xrotation", "Yrotation")
# Name, parent, offset [cm], y up: a made-up skeleton in a T pose, with arms that point a little down and back.
SKELETON = [("hip", "", (0, 90, 0)), ("abdomen", "hip", (0, 20, -1)), ("chest", "abdomen", (0, 12, 0)),
            ("neck", "chest", (0, 22, -2)), ("head", "neck", (0, 7, 1))]  # fmt: skip
for _side, _x in (("l", 1), ("r", -1)):
    SKELETON += [
        (f"{_side}Collar", "chest", (3 * _x, 19, -5)), (f"{_side}Shldr", f"{_side}Collar", (9 * _x, -2, 1)),
        (f"{_side}ForeArm", f"{_side}Shldr", (28 * _x, -2, 1)), (f"{_side}Hand", f"{_side}ForeArm", (23 * _x, -3, 2)),
        (f"{_side}Mid1", f"{_side}Hand", (8 * _x, 1, 3)), (f"{_side}Buttock", "hip", (9 * _x, 4, 1)),
        (f"{_side}Thigh", f"{_side}Buttock", (0, -2, -2)), (f"{_side}Shin", f"{_side}Thigh", (0, -37, 1)),
        (f"{_side}Foot", f"{_side}Shin", (-_x, -45, -5)),
    ]  # fmt: skip
NAMES = tuple(name for name, _, _ in SKELETON)


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


def daz_clip(angles: np.ndarray, fps: float = 30.0) -> BvhClip:
    """Clip of Euler angles [frames, joints, 3] in degrees."""
    return BvhClip(
        joint_names=NAMES,
        parents=np.array([NAMES.index(parent) if parent else -1 for _, parent, _ in SKELETON]),
        offsets=np.array([offset for _, _, offset in SKELETON], dtype=float),
        channels=(CHANNELS,) * len(NAMES),
        values=angles.reshape(len(angles), -1).astype(float),
        frame_time=1 / fps,
        source="made-up",
    )


def random_angles(frames: int, degrees: float = 40.0) -> np.ndarray:
    """Random but slow: from one random pose to another."""
    rng = np.random.default_rng(7)
    ends = rng.uniform(-degrees, degrees, (2, len(NAMES), 3))
    share = np.linspace(0, 1, frames)[:, None, None]
    return ends[0] * (1 - share) + ends[1] * share


def to_body_axes(vector: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack([x, -z, y], axis=-1)


def bone_directions(motion: Motion, body: BodyModel, joint: str, end: str) -> np.ndarray:
    _, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    bone = joints[:, body.joint_names.index(end)] - joints[:, body.joint_names.index(joint)]
    return torch.nn.functional.normalize(bone, dim=-1).numpy()


def source_directions(clip: BvhClip, joint: str, end: str) -> np.ndarray:
    bone = clip.world_rotations()[:, clip.joint_names.index(joint)] @ clip.offsets[clip.joint_names.index(end)]
    return to_body_axes(bone / np.linalg.norm(bone, axis=-1, keepdims=True))


@pytest.mark.parametrize(
    ("joint", "end", "source", "source_end"),
    [
        ("LeftArm", "LeftForeArm", "lShldr", "lForeArm"),
        ("LeftForeArm", "LeftHand", "lForeArm", "lHand"),
        ("LeftHand", "LeftFingerBase", "lHand", "lMid1"),
        ("LeftUpLeg", "LeftLeg", "lThigh", "lShin"),
        ("RightForeArm", "RightHand", "rForeArm", "rHand"),
        ("RightLeg", "RightFoot", "rShin", "rFoot"),
    ],
)
def test_world_directions_of_limbs_are_those_of_the_source(
    body: BodyModel, joint: str, end: str, source: str, source_end: str
) -> None:
    clip = daz_clip(random_angles(8))
    found = bone_directions(retarget_bvh(clip, body), body, joint, end)
    np.testing.assert_allclose(found, source_directions(clip, source, source_end), atol=1e-5)


def test_resting_source_leaves_trunk_and_head_at_rest(body: BodyModel) -> None:
    motion = retarget_bvh(daz_clip(np.zeros((2, len(NAMES), 3))), body)
    rotations, _ = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    trunk = [body.joint_names.index(name) for name in ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")]
    assert torch.allclose(rotations[:, trunk], torch.eye(3), atol=1e-6)
    # Only the arms go from the A pose to the T pose.
    assert bone_directions(motion, body, "LeftArm", "LeftForeArm")[0, 0] > 0.99


@pytest.mark.parametrize(
    ("column", "axis"),
    [(1, (1, 0, 0)), (2, (0, 0, 1)), (0, (0, -1, 0))],
    ids=["x bends forward", "y turns left", "z leans right"],
)
def test_a_head_turn_keeps_its_sense(body: BodyModel, column: int, axis: tuple[int, int, int]) -> None:
    angles = np.zeros((1, len(NAMES), 3))
    angles[:, NAMES.index("head"), column] = 30
    motion = retarget_bvh(daz_clip(angles), body)
    head = motion.body_pose[0].unflatten(0, (27, 3))[body.joint_names.index("Head")]
    np.testing.assert_allclose(np.degrees(head.numpy()), 30 * np.array(axis), atol=1e-4)


def test_neck_and_lower_back_take_half(body: BodyModel) -> None:
    angles = np.zeros((1, len(NAMES), 3))
    angles[:, NAMES.index("neck"), 2] = 40
    angles[:, NAMES.index("abdomen"), 1] = 20
    pose = np.degrees(retarget_bvh(daz_clip(angles), body).body_pose[0].unflatten(0, (27, 3)).numpy())
    expected = {
        "LowerBack": (10, 0, 0),
        "Spine": (10, 0, 0),
        "Neck": (0, 0, 20),
        "Neck1": (0, 0, 20),
        "Head": (0, 0, 0),
    }
    for name, degrees in expected.items():
        np.testing.assert_allclose(pose[body.joint_names.index(name)], degrees, atol=1e-4)


def test_the_root_is_turned_but_not_moved(body: BodyModel) -> None:
    angles = np.zeros((1, len(NAMES), 3))
    angles[:, 0, 2] = 90
    motion = retarget_bvh(daz_clip(angles), body)
    expected = Rotation.from_rotvec([0, 0, np.pi / 2]).as_rotvec()
    np.testing.assert_allclose(motion.body_pose[0, :3].numpy(), expected, atol=1e-5)


def test_the_lead_in_is_dropped_only_after_a_rest_pose(body: BodyModel) -> None:
    angles = random_angles(136, degrees=10)
    whole = retarget_bvh(daz_clip(angles, fps=120), body)
    assert (len(whole), whole.start) == (34, 0)
    angles[0] = 0
    clip = daz_clip(angles, fps=120)
    motion = retarget_bvh(clip, body)
    assert len(motion) == 31
    np.testing.assert_allclose(motion.times[:2], [15 / 120, 15 / 120 + 1 / 30])  # in the file
    found = bone_directions(motion, body, "LeftArm", "LeftForeArm")
    np.testing.assert_allclose(found, source_directions(clip, "lShldr", "lForeArm")[15::4], atol=1e-5)


def test_read_motion_knows_its_formats(tmp_path: Path, body: BodyModel) -> None:
    np.savez(tmp_path / "poses.npz", body_pose=np.full((4, 81), 0.1, dtype=np.float32), fps=25.0)
    motion = read_motion(tmp_path / "poses.npz", body)
    assert (motion.name, motion.fps, motion.body_pose.shape) == ("poses", 25.0, (4, 81))
    (tmp_path / "walk.mov").write_bytes(b"")
    with pytest.raises(InputError, match=r"\.bvh, \.glb, \.gltf, \.fbx, \.npz.*suffix '\.mov'"):
        read_motion(tmp_path / "walk.mov", body)
    with pytest.raises(InputError, match="no such file"):
        read_motion(tmp_path / "none.bvh", body)
    np.savez(tmp_path / "narrow.npz", body_pose=np.zeros((4, 72), dtype=np.float32), fps=25.0)
    with pytest.raises(InputError, match=r"narrow\.npz.*81"):
        read_motion(tmp_path / "narrow.npz", body)


@pytest.mark.shared_data
def test_real_clips_walk_upright_and_forward(shared_data: Path, body: BodyModel) -> None:
    motion = read_motion(shared_data / "motion/07_01.bvh", body)
    assert (len(motion), motion.fps, motion.name) == (76, 30.0, "07_01")
    rotations, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    head, hips = (body.joint_names.index(name) for name in ("Head", "Hips"))
    assert (joints[:, head, 2] - joints[:, hips, 2]).min() > 0.6
    # Face and hips look the same way, hands are below the shoulders, left is on the left.
    assert (rotations[:, head, :, 1] * rotations[:, hips, :, 1]).sum(-1).min() > 0.8
    for side, outward in (("Left", 1.0), ("Right", -1.0)):
        hand, shoulder = (joints[:, body.joint_names.index(f"{side}{end}")] for end in ("Hand", "Arm"))
        assert (hand - shoulder)[:, 2].max() < -0.1
        lateral = ((hand - joints[:, hips]) * rotations[:, hips, :, 0]).sum(-1)
        assert (outward * lateral).mean() > 0.15


@pytest.mark.shared_data
def test_a_real_flip_is_repaired(shared_data: Path, body: BodyModel) -> None:
    """CMU 13_14 twists neck and head by 90 degrees and back within 12 frames of 1/120 s."""
    motion = retarget_bvh(read_bvh(shared_data / "motion/13_14.bvh"), body)
    head = motion.body_pose.unflatten(-1, (27, 3))[:, body.joint_names.index("Neck1")]
    assert head[215:230].diff(dim=0).norm(dim=-1).max() < np.radians(3)
