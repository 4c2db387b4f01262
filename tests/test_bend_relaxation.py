"""Bends of contact spread along a strand: against a dense solution, and against cases by hand."""

import pytest
import torch

from quaffure.geometry import matrix_from_axis_angle
from quaffure.model import NetworkConfig
from quaffure.model.bend_relaxation import bends, relaxed_edges
from quaffure.model.network_config import from_file_values
from quaffure.types import Tensor

EDGES = 9


def directions(generator: torch.Generator, spread: float = 0.4) -> Tensor:
    """Unit edges [2, 3, edge, 3] of strands that bend."""
    steps = spread * torch.randn(2, 3, EDGES, 3, generator=generator, dtype=torch.float64)
    start = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    return torch.nn.functional.normalize(start + steps.cumsum(2) / 3, dim=-1)


def stiffness(generator: torch.Generator) -> tuple[Tensor, Tensor]:
    bending, goal = torch.rand(2, 2, 3, EDGES, generator=generator, dtype=torch.float64)
    return bending + 0.2, goal * (goal > 0.7)


def test_small_rotations_are_those_of_the_dense_system() -> None:
    generator = torch.Generator().manual_seed(0)
    free, (bending, goal) = directions(generator), stiffness(generator)
    turned = matrix_from_axis_angle(1e-4 * torch.randn(2, 3, EDGES, 3, generator=generator, dtype=torch.float64))
    edges = (turned @ free[..., None])[..., 0]
    ones = torch.ones(EDGES, dtype=torch.float64)
    difference = torch.diag(ones) - torch.diag(ones[1:], -1)
    whole = difference.T @ (bending[..., None] * difference) + torch.diag_embed(bending / 4 + goal)
    theta = torch.linalg.solve(whole, -difference.T @ (bending[..., None] * bends(edges, free)))
    expected = edges + torch.linalg.cross(theta, edges)
    assert theta.norm(dim=-1).max() > 5e-5
    torch.testing.assert_close(relaxed_edges(edges, free, bending, bending / 4 + goal), expected, atol=5e-8, rtol=0)


def test_without_contact_edges_stay() -> None:
    generator = torch.Generator().manual_seed(1)
    free, (bending, goal) = directions(generator), stiffness(generator)
    torch.testing.assert_close(relaxed_edges(free, free, bending, bending / 5 + goal), free, atol=1e-12, rtol=0)


def test_a_bend_at_the_root_spreads() -> None:
    """Strands that turn as a whole about an axis across their first edge are bent at the root alone."""
    generator = torch.Generator().manual_seed(2)
    free, (bending, _) = directions(generator), stiffness(generator)
    across = torch.linalg.cross(
        free[..., :1, :], torch.randn(3, generator=generator, dtype=torch.float64).expand(2, 3, 1, 3)
    )
    edges = free @ matrix_from_axis_angle(0.6 * torch.nn.functional.normalize(across, dim=-1))[..., 0, :, :].mT
    before, after = bends(edges, free), bends(relaxed_edges(edges, free, bending, bending / 5), free)
    assert before[..., 1:, :].norm(dim=-1).max() < 1e-12
    assert (after[..., 0, :].norm(dim=-1) < 0.9 * before[..., 0, :].norm(dim=-1)).all()
    assert (after[..., 1, :].norm(dim=-1) > 0.02).all()
    # What holds edges where they are is small beside the joints: bends cost less than before.
    cost = bending[..., None] * torch.stack([before, after]).square()
    assert (cost[1].sum((-1, -2)) < 0.7 * cost[0].sum((-1, -2))).all()


@pytest.mark.parametrize(("values", "expected"), [({"initial_shape": {}}, 0.0), ({}, 5.0)])
def test_older_networks_start_as_they_did(values: dict[str, object], expected: float) -> None:
    """Their files hold settings of the initial shape without this one."""
    assert from_file_values(values).initial_shape.bend_relaxation == expected


def test_older_networks_are_projected_as_they_were() -> None:
    projection = from_file_values({"projection": {"most": 0.02}}).projection
    assert (projection.push_relaxation, projection.pushes, projection.most) == (0.0, 1, 0.02)


def test_runs_of_before_are_not_continued_with_another_projection() -> None:
    assert "projection" not in repr(from_file_values({"projection": {}}))
    assert "push_relaxation=2.0" in repr(NetworkConfig())
