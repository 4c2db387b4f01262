import torch

from quaffure.body import BodyModel, HeadFrameBody, MlsBodyConfig, head_frame_body, head_frame_body_reference
from quaffure.body.kinematics import pose_joints

CONFIG = MlsBodyConfig()


def bodies() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    pose, shape = 0.4 * torch.randn(5, 81, generator=generator), torch.randn(5, 10, generator=generator)
    pose[0], shape[0] = 0, 0
    pose[1, :3] = torch.tensor([0.3, -0.2, 2.5])  # hips turned far about the vertical
    return pose, shape


def compiled_body(body: BodyModel, pose: torch.Tensor, shape: torch.Tensor) -> HeadFrameBody:
    return head_frame_body(body, pose, shape, pose_joints(body, pose, shape), CONFIG)


def test_compiled_joints_are_those_of_torch(body: BodyModel) -> None:
    pose, shape = bodies()
    rest, rotations, positions = pose_joints(body, pose, shape)
    expected_rotations, expected_positions = body.posed_joints(pose, shape)
    torch.testing.assert_close(rotations.float(), expected_rotations, atol=2e-6, rtol=0)
    torch.testing.assert_close(positions.float(), expected_positions, atol=1e-6, rtol=0)
    torch.testing.assert_close(rest.float(), body.rest(shape)[1], atol=1e-6, rtol=0)
    differentiable = pose_joints(body, pose.requires_grad_(), shape)
    assert differentiable.positions.requires_grad
    torch.testing.assert_close(differentiable.rest, body.rest(shape)[1], atol=1e-6, rtol=0)


def test_the_compiled_view_is_the_one_of_the_posed_body(body: BodyModel) -> None:
    compiled = compiled_body(body, *bodies())
    expected = head_frame_body_reference(body, *bodies(), body.pose(*bodies()), CONFIG)
    torch.testing.assert_close(compiled.world_skin, expected.world_skin, atol=3e-6, rtol=0)
    for field in ("world_from_head", "head_position", "pose_code", "scalp"):
        torch.testing.assert_close(getattr(compiled, field), getattr(expected, field), atol=2e-6, rtol=0)
    torch.testing.assert_close(compiled.surface.points, expected.surface.points, atol=2e-6, rtol=0)
    torch.testing.assert_close(compiled.surface.normals, expected.surface.normals, atol=2e-6, rtol=0)


def test_a_sample_is_the_view_of_that_body_alone(body: BodyModel) -> None:
    pose, shape = bodies()
    sample, alone = compiled_body(body, pose, shape).sample(3), compiled_body(body, pose[3:4], shape[3:4])
    assert torch.equal(sample.scalp, alone.scalp)
    assert torch.equal(sample.surface.normals, alone.surface.normals)


def test_heading_is_not_seen(body: BodyModel) -> None:
    poses = torch.zeros(3, 81)
    poses[1, 2] = 1.0  # the hips, about the vertical
    poses[2, 3 * body.joint_names.index("Head")] = 0.4
    view = compiled_body(body, poses, torch.zeros(3, 10))
    torch.testing.assert_close(view.pose_code[1], view.pose_code[0], atol=2e-6, rtol=0)
    torch.testing.assert_close(view.scalp[1], view.scalp[0], atol=2e-6, rtol=0)
    assert (view.pose_code[2] - view.pose_code[0]).abs().max() > 0.1
