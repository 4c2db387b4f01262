"""The rod in edge directions: its compiled form against autograd, its properties, and theory."""

from dataclasses import replace

import pytest
import torch

from benchmarks.rods.direction_rod import CASES, RIGID, errors_mm, spring_compliance
from quaffure.energies import TWISTING_STIFFNESS, RodRest, energy_at_twist, energy_rod, stress_free_rest
from quaffure.energies.rod import equilibrium_twist
from quaffure.energies.rod_kernels import fused_rod, rod_arrays
from quaffure.geometry import directors, matrix_from_axis_angle
from quaffure.types import Float, Tensor

STRANDS, EDGES = 6, 9


def _random(shape: tuple[int, ...], seed: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def _strands(change: float = 0.0, seed: int = 0) -> Float[Tensor, "s n 3"]:
    """Strands of edges about a centimetre long that turn at random, and the same ones bent further."""
    edges = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64) + 0.5 * _random((STRANDS, EDGES, 3), 0)
    return torch.nn.functional.pad(0.01 * (edges + change * _random(tuple(edges.shape), seed)).cumsum(1), (0, 0, 1, 0))


def _rest() -> RodRest:
    """A rod with every part of the equation at work: curled, twisted at rest, of uneven stiffness, partly held."""
    rest = stress_free_rest(_strands(), 1 + _random((STRANDS, EDGES), 1).abs())
    weight = torch.where(torch.arange(EDGES) < 3, 2e-6, 0.0).double().expand(STRANDS, EDGES)
    return replace(rest, rest_twist=0.3 * _random((STRANDS, EDGES), 2), goal_weight=weight)


def _draped(change: float = 0.3) -> tuple[Float[Tensor, "b s n 3"], Float[Tensor, "b s 3 3"]]:
    positions = torch.stack([_strands(change, 5), _strands(change, 6)])
    return positions, matrix_from_axis_angle(0.3 * _random((2, STRANDS, 3), 7))


def _gradient(energy: Tensor, positions: Tensor) -> Tensor:
    return torch.autograd.grad(energy.sum(), positions)[0]


def _relative(value: Tensor, truth: Tensor) -> float:
    return float((value.double() - truth).norm() / truth.norm())


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-6), (torch.float32, 1e-5)])
def test_compiled_energy_and_gradient_equal_autograd(dtype: torch.dtype, tolerance: float) -> None:
    rest, (positions, rotation) = _rest(), _draped()
    positions.requires_grad_()
    truth = energy_rod(positions, rest, rotation)
    single = positions.detach().to(dtype).requires_grad_()
    energy = fused_rod(single, rod_arrays(rest, dtype), rotation.to(dtype))
    assert _relative(energy.detach(), truth.detach()) < tolerance
    assert _relative(_gradient(energy, single), _gradient(truth, positions)) < tolerance


def test_every_part_of_the_energy_is_at_work_in_these_tests() -> None:
    """Otherwise a gradient that misses a part would pass."""
    rest, (positions, rotation) = _rest(), _draped()
    whole, direction = energy_rod(positions, rest, rotation), directors(positions)
    twist = equilibrium_twist(direction, rest, rotation)
    assert float(twist.abs().mean()) > 0.05
    for field in ("bending_stiffness", "twisting_stiffness", "goal_weight"):
        without = replace(rest, **{field: torch.zeros_like(rest.goal_weight)})
        assert float((whole - energy_at_twist(direction, twist, without, rotation)).min()) > 0.02 * float(whole.max())


def test_gradient_is_the_central_difference() -> None:
    """Twist is solved anew at both ends, so this checks the envelope theorem as well."""
    rest, (positions, rotation) = _rest(), _draped()
    positions.requires_grad_()
    gradient = _gradient(fused_rod(positions, rod_arrays(rest, torch.float64), rotation), positions)
    change = 1e-7 * _random(tuple(positions.shape), 9)
    ends = [energy_rod(positions.detach() + sign * change, rest, rotation).sum() for sign in (1, -1)]
    difference, expected = float(ends[0] - ends[1]) / 2, float((gradient * change).sum())
    assert abs(expected) > 1e-12
    assert difference == pytest.approx(expected, rel=1e-6)


def test_twist_is_the_minimum() -> None:
    rest, (positions, rotation) = _rest(), _draped()
    direction = directors(positions)
    twist = equilibrium_twist(direction, rest, rotation).requires_grad_()
    energy = energy_at_twist(direction, twist, rest, rotation)
    (slope,) = torch.autograd.grad(energy.sum(), twist)
    assert float(slope.abs().max()) < 1e-5 * float(rest.twisting_stiffness.mean())
    for seed in range(5):
        other = energy_at_twist(direction, twist.detach() + 0.2 * _random(tuple(twist.shape), seed), rest, rotation)
        assert bool((other > energy).all())


def test_twist_descends_from_any_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Far from rest the bending energy is not convex in the twist, and plain Newton steps cycle."""
    rest, (positions, rotation) = _rest(), _draped(1.5)
    energies = []
    for steps in range(12):
        monkeypatch.setattr("quaffure.energies.rod.MOST_TWIST_STEPS", steps)
        direction = directors(positions)
        twist = equilibrium_twist(direction, rest, rotation)
        energies.append(energy_at_twist(direction, twist, rest, rotation))
    falls = -torch.stack(energies).diff(dim=0)
    assert bool((falls > -1e-12 * energies[0]).all())
    assert bool((falls[0] > 0.05 * energies[0]).all())


def test_twist_does_not_run_off_where_the_exact_system_is_nearly_singular() -> None:
    """Strands in tangles, of which some had twists of ten turns and a thousand times their energy."""
    count, edges = 400, 23
    rest_edges = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64) + 0.5 * _random((count, edges, 3), 0)
    rest, tangled = (
        torch.nn.functional.pad(0.012 * shape.cumsum(1), (0, 0, 1, 0))
        for shape in (rest_edges, rest_edges + _random((count, edges, 3), 1))
    )
    rod, positions, rotation = stress_free_rest(rest), tangled[None], torch.eye(3).double().expand(1, count, 3, 3)
    assert float(equilibrium_twist(directors(positions), rod, rotation).abs().max()) < 10
    energy = fused_rod(positions, rod_arrays(rod, torch.float64), rotation)
    torch.testing.assert_close(energy, energy_rod(positions, rod, rotation), rtol=1e-4, atol=0)


def test_posed_rest_shape_is_free_of_energy_and_force() -> None:
    strands = _strands()
    rotation = matrix_from_axis_angle(_random((1, STRANDS, 3), 4))
    positions = (strands @ rotation.mT).requires_grad_()
    energy = fused_rod(positions, rod_arrays(stress_free_rest(strands), torch.float64), rotation)
    assert float(energy.detach()) < 1e-20
    assert float(_gradient(energy, positions).abs().max()) < 1e-16


def test_energy_is_unchanged_by_a_rotation_of_everything() -> None:
    rest, (positions, rotation) = _rest(), _draped()
    turn = matrix_from_axis_angle(torch.tensor([0.3, -1.0, 0.7], dtype=torch.float64))
    before = energy_rod(positions, rest, rotation)
    torch.testing.assert_close(energy_rod(positions @ turn.T + 1, rest, turn @ rotation), before)
    assert not torch.allclose(energy_rod(positions @ turn.T, rest, rotation), before)


def test_twisting_the_free_end_is_undone_by_the_material_frames() -> None:
    """A quarter helix wound about its own axis costs less energy than one whose frames can't twist."""
    rest, (positions, rotation) = _rest(), _draped()
    free = energy_rod(positions, rest, rotation)
    direction = directors(positions)
    rigid = energy_at_twist(direction, rest.rest_twist.cumsum(-1).expand(direction.shape[:3]), rest, rotation)
    assert bool((free < 0.98 * rigid).all())


def test_rotation_gradient_is_refused() -> None:
    rest, (positions, rotation) = _rest(), _draped()
    with pytest.raises(ValueError, match="a body without gradient"):
        fused_rod(positions, rod_arrays(rest, torch.float64), rotation.requires_grad_())


def test_edge_without_length_gets_no_force() -> None:
    rest, (positions, rotation) = _rest(), _draped()
    positions[:, :, 4] = positions[:, :, 3]
    positions.requires_grad_()
    gradient = _gradient(fused_rod(positions, rod_arrays(rest, torch.float64), rotation), positions)
    assert bool(torch.isfinite(gradient).all())


# Largest distance from the heavy rod at 24 vertices [mm].
HEAVY_ROD = {"straight": 1.5, "curl": 3.5, "hanging curl": 3.5, "curl raised by 45 deg": 3.5}
OTHER_DIRECTIONS = ("hanging curl", "curl raised by 45 deg")
"""Of the curl, whose energy rotates with it (`test_energy_is_unchanged_by_a_rotation_of_everything`)."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if name in OTHER_DIRECTIONS else ()) for name in HEAVY_ROD]
)
def test_rod_converges_to_the_heavy_rod(name: str) -> None:
    coarse, medium, fine = (errors_mm(CASES[name], vertices)[1] for vertices in (12, 24, 48))
    assert medium < HEAVY_ROD[name]
    assert fine < medium / 2.5
    assert medium < coarse / 1.5


@pytest.mark.slow
def test_curl_needs_twist() -> None:
    """With frames that can't twist, a curl is off by a centimetre."""
    assert errors_mm(CASES["curl"], 24, RIGID * TWISTING_STIFFNESS)[1] > 8


def test_helix_stretches_as_a_spring() -> None:
    found, theory = spring_compliance(24)
    assert found == pytest.approx(theory, rel=0.15)
    assert abs(spring_compliance(48)[0] / spring_compliance(48)[1] - 1) < 0.04
    assert spring_compliance(24, RIGID * TWISTING_STIFFNESS)[0] < 0.6 * theory
