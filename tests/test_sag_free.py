"""Sag-free rest shapes: the design is in balance, and a minimum, of the whole energy."""

from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.body import BodyModel
from quaffure.config import STANDARD_GRAVITY
from quaffure.energies import (
    RestState,
    SagFreeRest,
    energy_body_collision,
    energy_gravity,
    energy_rod,
    sag_free_rest,
    stress_free_rest,
)
from quaffure.energies.rest_state import rest_state
from quaffure.energies.sag_free import residual, sag_free_report
from quaffure.geometry import Surface, integrate_directions_reference
from quaffure.geometry.signed_distance import signed_distance
from quaffure.hair import Groom
from quaffure.types import Energy, Float, Tensor
from tests.scenes import few_strands

STYLES = (pytest.param("long_ringlets", marks=pytest.mark.slow), "afro", "bob")


def _total(direction: Tensor, groom: Groom, rest: SagFreeRest, surface: Surface) -> Energy:
    """Rod, weight and contact by exact distances [J] of a groom whose edges point along `direction`."""
    material = HairMaterial()
    state: RestState = rest_state(groom.rest_strands.double(), material)
    strands = state.rest_strands
    positions = integrate_directions_reference(strands[None, :, 0], direction[None], state.rest_length)
    rotation = torch.eye(3, dtype=torch.float64).expand(1, len(strands), 3, 3)
    distance = signed_distance(positions.flatten(1, 2), surface).reshape(positions.shape[:3])
    contact = energy_body_collision(distance[:, :, 1:], rest.collision_margin[:, 1:], material.k_body_collision)
    return energy_rod(positions, rest.rod, rotation) + energy_gravity(positions, state.mass) + contact


def _directions(groom: Groom) -> Float[Tensor, "s e 3"]:
    return torch.nn.functional.normalize(groom.rest_strands.double().diff(dim=1), dim=-1)


@pytest.mark.parametrize("style", STYLES)
def test_design_is_in_balance(style: str, body: BodyModel, surface: Surface) -> None:
    """By autograd through the torch energies, which share no code with the kernel that `residual` reads."""
    groom = few_strands(body, style)
    rest = sag_free_rest(groom, body)
    direction = _directions(groom).requires_grad_()
    (gradient,) = torch.autograd.grad(_total(direction, groom, rest, surface).sum(), direction)
    state = rest_state(groom.rest_strands.double(), HairMaterial())
    weight = STANDARD_GRAVITY * state.mass[:, 1:]
    assert float((gradient.norm(dim=-1) / (state.rest_length * weight)).max()) < 1e-4
    assert float(residual(groom, rest).max()) < 1e-6
    assert float(rest.support.max()) > 2 * float(weight.max())
    assert float(rest.rod.rest_twist.abs().max()) > 1e-3


@pytest.mark.parametrize("style", STYLES)
def test_design_is_a_minimum(style: str, body: BodyModel, surface: Surface) -> None:
    """No small rotation of random edges lowers the energy of any strand."""
    groom = few_strands(body, style, 20)
    rest = sag_free_rest(groom, body)
    direction = _directions(groom)
    before = float(_total(direction, groom, rest, surface))
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        change = 0.01 * torch.randn(direction.shape, generator=generator, dtype=torch.float64).cumsum(1)
        moved = torch.nn.functional.normalize(direction + change, dim=-1)
        assert float(_total(moved, groom, rest, surface)) > before


def test_stress_free_rest_is_not_in_balance(body: BodyModel) -> None:
    """Else the tests above would show nothing."""
    groom = few_strands(body, "long_ringlets")
    rest = sag_free_rest(groom, body)
    free = replace(rest, rod=stress_free_rest(groom.rest_strands.double()))
    assert float(residual(groom, free).median()) > 0.5


def test_held_edges_take_what_a_tail_asks_for(body: BodyModel) -> None:
    groom = few_strands(body, "ponytail")
    held = (torch.arange(groom.rest_lengths.shape[1]) < 11).expand(groom.rest_lengths.shape)
    rest = sag_free_rest(groom, body, held=held)
    assert float(residual(groom, rest).max()) < 1e-6
    assert bool(((rest.rod.goal_weight > 0) == held).all())
    assert bool((rest.support[:, 1:][held] == 0).all())
    assert sag_free_report(groom, rest).above_10_percent <= 10


def test_ties_of_the_groom_are_held_unless_others_are_named(body: BodyModel) -> None:
    groom = few_strands(body, "half_up")
    rest = sag_free_rest(groom, body)
    assert bool(((rest.rod.goal_weight > 0) == groom.held_edges).all())
    assert bool(groom.held_edges.any())
    assert not bool(groom.held_edges.all())
    by_name = sag_free_rest(replace(groom, tie_vertex=None, goal_weight=None), body, None, groom.held_edges)
    torch.testing.assert_close(rest.rod.goal_weight, by_name.rod.goal_weight)
    none = sag_free_rest(groom, body, held=torch.zeros_like(groom.held_edges))
    assert not bool((none.rod.goal_weight > 0).any())
    assert float(residual(groom, none).max()) < 1e-6


def test_goals_weigh_at_least_what_an_artist_asks_for(body: BodyModel) -> None:
    groom = few_strands(body, "half_up")
    usual = sag_free_rest(groom, body).rod.goal_weight
    asked = torch.zeros_like(groom.rest_lengths)
    asked[:, 5:9] = float(usual.median())
    rest = sag_free_rest(replace(groom, goal_weight=asked), body)
    assert bool((rest.rod.goal_weight >= asked).all())
    assert bool(((rest.rod.goal_weight > 0) == (groom.held_edges | (asked > 0))).all())
    assert float(residual(replace(groom, goal_weight=asked), rest).max()) < 1e-6
    strong = replace(groom, goal_weight=100 * groom.held_edges * usual.float())
    torch.testing.assert_close(sag_free_rest(strong, body).rod.goal_weight, strong.goal_weight, check_dtype=False)


def test_stiffness_that_an_artist_asks_for_is_multiplied_further(body: BodyModel) -> None:
    groom = few_strands(body, "long_ringlets")
    asked = 1 + 4 * torch.rand(groom.rest_lengths.shape, generator=torch.Generator().manual_seed(0))
    stiff = replace(groom, stiffness_scale=asked)
    rest, usual = (sag_free_rest(groom, body) for groom in (stiff, groom))
    assert bool((rest.rod.stiffness_scale >= asked - 1e-6).all())
    assert float(residual(stiff, rest).max()) < 1e-6
    bend = rest.rod.bending_stiffness / rest.rod.stiffness_scale
    torch.testing.assert_close(bend, usual.rod.bending_stiffness / usual.rod.stiffness_scale)
    # Stiffer hair has to be stiffened less.
    assert sag_free_report(stiff, rest).stiffened_percent < sag_free_report(groom, usual).stiffened_percent


def test_margins_never_exceed_the_clearance_where_nothing_is_supported(body: BodyModel, surface: Surface) -> None:
    groom = few_strands(body, "long_straight")
    rest = sag_free_rest(groom, body)
    distance = signed_distance(groom.rest_strands.double().flatten(0, 1)[None], surface).view(rest.support.shape)
    free = rest.support == 0
    assert bool((rest.collision_margin <= distance + 1e-9)[free].all())
    assert bool((rest.collision_margin > distance)[~free].all())


@pytest.mark.parametrize("name", ["linear_density", "k_body_collision"])
def test_a_gradient_that_supports_do_not_have_is_refused(body: BodyModel, name: str) -> None:
    value = torch.tensor(getattr(HairMaterial(), name), requires_grad=True)
    with pytest.raises(InputError, match=f"{name}: expected no gradient"):
        sag_free_rest(few_strands(body, "bob", 4), body, replace(HairMaterial(), **{name: value}))
