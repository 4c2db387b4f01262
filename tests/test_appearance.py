"""Metrics of what one sees."""

import math

import torch

from quaffure.benchmark.appearance import GAP, in_the_air, jumps, off_vertical, velocity_changes
from tests.scenes import posed_scene, sphere_groom

RADIUS = 0.1  # of the sphere [m]


def _straight(
    root: tuple[float, float, float], direction: tuple[float, float, float], step: float = 0.01
) -> torch.Tensor:
    along = step * torch.arange(24.0)[:, None]
    return torch.tensor(root) + along * torch.nn.functional.normalize(torch.tensor(direction), dim=0)


def test_angle_of_the_outer_edges_to_gravity() -> None:
    hanging, standing, level = (_straight((0, 0, 0), end) for end in ((0, 0, -1.0), (0, 0, 1.0), (1.0, 0, 0)))
    angles = off_vertical(torch.stack([hanging[None], standing[None], level[None]]))
    torch.testing.assert_close(angles, torch.tensor([0.0, 180.0, 90.0]), atol=0.1, rtol=0)
    bent = level.clone()
    bent[11:] = bent[11] + torch.stack([torch.zeros(13), torch.zeros(13), -0.01 * torch.arange(13.0)], dim=1)
    assert float(off_vertical(bent[None, None])) < 0.1  # what is inside does not count


def test_hair_that_nothing_carries_is_in_the_air() -> None:
    """Three shells of hair over a sphere: on the skin, on that hair, and far above both."""
    scene = posed_scene(sphere_groom(strands=3))
    angle = torch.linspace(0.2, 1.2, 24)
    shells = []
    for height, shift in ((0.5 * GAP, 0.0), (1.2 * GAP, 0.01), (4 * GAP, 0.0)):
        radius = RADIUS + height
        circle = [radius * torch.sin(angle), torch.full_like(angle, shift * radius), radius * torch.cos(angle)]
        shells.append(torch.stack(circle, dim=1))
    lone = in_the_air(torch.stack(shells)[None], scene)[0]
    assert lone.float().mean(dim=1).tolist() == [0.0, 0.0, 1.0]
    without_middle = in_the_air(torch.stack([shells[0], shells[1] + 1.0, shells[1]])[None], scene)[0]
    assert not bool(without_middle[2].any())  # carried by the first


def test_jumps_are_beyond_what_root_and_pose_move() -> None:
    posed = _straight((0, 0, 0), (0, 0, -1.0))[None].repeat(3, 2, 1, 1)
    posed[1:] += torch.tensor([0.06, 0.0, 0.0])
    draped = posed.clone()
    draped[2, 1, -1] += torch.tensor([0.0, 0.08, 0.0])
    moved = jumps(draped, posed)
    expected = torch.tensor([[0.0, 0.0], [0.0, 0.08]])
    torch.testing.assert_close(moved, expected)
    assert math.isclose(float(moved.max()), 0.08, abs_tol=1e-6)


def test_tips_that_move_evenly_do_not_tremble() -> None:
    frame = torch.arange(5.0)[:, None]
    even, trembling = 0.02 * frame, 0.02 * frame + 0.003 * (frame % 2)
    tips = torch.stack([torch.cat([moved, torch.zeros(5, 2)], dim=1) for moved in (even, trembling)], dim=1)
    torch.testing.assert_close(velocity_changes(tips), torch.tensor([[0.0, 0.006]]).repeat(3, 1))
