import pytest
import torch

from quaffure import InputError
from quaffure.body import CLIP_NAMES, BodyModel, Motion, bundled_clip, joint_matrices, load_body
from quaffure.geometry import axis_angle_from_matrix


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


def world_rotations(motion: Motion, body: BodyModel, joint: str) -> torch.Tensor:
    rotations, _ = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    return rotations[:, body.joint_names.index(joint)]


def facing_left_degrees(rotations: torch.Tensor) -> torch.Tensor:
    """Turn of the face (-y at rest) to the body's left (+x), seen from above."""
    forward = -rotations[..., 1]
    return torch.rad2deg(torch.atan2(forward[..., 0], -forward[..., 1]))


def test_the_six_clips() -> None:
    assert CLIP_NAMES == ("neck_turn", "nod", "bow", "shrug", "walk", "idle")
    with pytest.raises(InputError, match="neck_turn, nod, bow, shrug, walk"):
        bundled_clip("sprint", load_body())


@pytest.mark.parametrize("name", CLIP_NAMES)
def test_loops_close_and_never_jump(name: str, body: BodyModel) -> None:
    motion = bundled_clip(name, body)
    assert motion.fps == 30.0
    assert 2.0 <= len(motion) / motion.fps <= 4.0
    rotations = joint_matrices(motion.body_pose)
    # The step after the last frame leads to the first one.
    steps = axis_angle_from_matrix(rotations.mT @ rotations.roll(-1, dims=0)).norm(dim=-1).rad2deg()
    assert steps.max() > 0.4
    assert steps.max() < 12.0
    # Smooth at the seam as elsewhere: no step differs from the next by more than the clip's own bends ask for.
    change = (steps - steps.roll(-1, dims=0)).abs()
    assert change[-2:].max() < 1.5


def test_neck_turn_goes_from_right_to_left(body: BodyModel) -> None:
    motion = bundled_clip("neck_turn", body)
    turn = facing_left_degrees(world_rotations(motion, body, "Head"))
    assert turn[0] < -65
    assert turn[len(motion) // 2] > 65
    assert facing_left_degrees(world_rotations(motion, body, "Spine1")).abs().max() < 1


def test_nod_looks_down_and_up(body: BodyModel) -> None:
    look = -world_rotations(bundled_clip("nod", body), body, "Head")[:, 2, 1]
    assert look.min() < -0.5
    assert look.max() > 0.2


def test_bow_leans_forward_with_standing_legs(body: BodyModel) -> None:
    motion = bundled_clip("bow", body)
    _, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    head = joints[:, body.joint_names.index("Head")]
    assert head[:, 1].min() < -0.5
    up = world_rotations(motion, body, "LeftUpLeg")[:, 2, 2]
    assert up.min() > 0.99


def test_shrug_lifts_both_shoulders(body: BodyModel) -> None:
    motion = bundled_clip("shrug", body)
    _, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    for arm in ("LeftArm", "RightArm"):
        height = joints[:, body.joint_names.index(arm), 2]
        assert height.max() - height[0] > 0.04


def test_walk_swings_arm_with_the_other_leg(body: BodyModel) -> None:
    motion = bundled_clip("walk", body)
    _, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    left_foot, right_foot, left_hand, right_hand = (
        -joints[:, body.joint_names.index(name), 1] for name in ("LeftFoot", "RightFoot", "LeftHand", "RightHand")
    )
    assert left_foot[0] - right_foot[0] > 0.3
    assert right_hand[0] - left_hand[0] > 0.15
    half = len(motion) // 2
    assert torch.allclose(left_foot.roll(half), right_foot, atol=1e-3)


@pytest.mark.parametrize("name", ["neck_turn", "nod", "walk"])
def test_arms_hang_beside_the_body(name: str, body: BodyModel) -> None:
    motion = bundled_clip(name, body)
    _, joints = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    for side, outward in (("Left", 1), ("Right", -1)):
        shoulder, hand = (joints[:, body.joint_names.index(f"{side}{end}")] for end in ("Arm", "Hand"))
        assert (shoulder - hand)[:, 2].min() > 0.35
        assert (outward * (hand - shoulder)[:, 0]).min() > 0.0


def test_idle_turns_nods_and_leans_by_ten_degrees(body: BodyModel) -> None:
    head = world_rotations(bundled_clip("idle", body), body, "Head")
    vectors = axis_angle_from_matrix(head[[15, 30, 45, 75, 90, 105]]).rad2deg()
    expected = torch.tensor([[0, 0, 10], [10, 0, 0], [0, 10, 0], [0, 0, -10], [-10, 0, 0], [0, -10, 0]])
    torch.testing.assert_close(vectors.float(), expected.float(), atol=0.05, rtol=0)
