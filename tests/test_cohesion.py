"""Cohesion of tails: what keeps a ponytail a ponytail."""

from dataclasses import replace

import pytest
import torch

from quaffure.body import BodyModel
from quaffure.energies import Cohesion, HairEnergy, hair_terms, sag_free_rest
from quaffure.energies.cohesion import tails_of
from quaffure.geometry import Surface, matrix_from_axis_angle
from quaffure.hair import Groom
from quaffure.scene import PosedScene
from tests.scenes import few_strands


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return few_strands(body, "pigtails")


@pytest.fixture(scope="module")
def scene(groom: Groom, surface: Surface) -> PosedScene:
    return PosedScene(groom, groom.rest_strands[None], surface)


def energy_of(groom: Groom) -> HairEnergy:
    tails = tails_of(groom)
    assert tails is not None
    return HairEnergy(groom, terms=(Cohesion(tails),))


def pulled(groom: Groom, far: float = 0.05) -> torch.Tensor:
    """The groom with the last six vertices of one strand of a tail moved aside by `far` [m]."""
    moved = groom.rest_strands.clone()[None]
    moved[0, tied_strand(groom), -6:, 1] += far
    return moved


def tied_strand(groom: Groom) -> int:
    assert groom.tie_vertex is not None
    return int((groom.tie_vertex > 0).nonzero()[0, 0])


def test_a_design_is_free_of_it_wherever_it_is(groom: Groom, scene: PosedScene) -> None:
    energy = energy_of(groom)
    rotation = matrix_from_axis_angle(torch.tensor([0.4, 1.0, -0.7]))
    assert float(energy.total(scene.posed @ rotation.T + torch.tensor([0.3, -2.0, 1.0]), scene)) == 0


def test_each_pigtail_has_a_centre_of_its_own(groom: Groom) -> None:
    tails = tails_of(groom)
    assert tails is not None
    # Of two bundles on both sides of the head, one common centre line would be in the head.
    assert float(tails.rest_distance.max()) < 0.05
    strand = tails.vertex // groom.rest_strands.shape[1]
    sides = groom.rest_strands[strand, -1, 0] > 0
    assert not set(tails.knot[sides].tolist()) & set(tails.knot[~sides].tolist())


def test_free_hair_and_hair_that_ends_in_its_tie_have_no_tails(groom: Groom) -> None:
    assert tails_of(replace(groom, tie_vertex=None)) is None
    assert tails_of(replace(groom, tie_vertex=torch.full((len(groom),), 23))) is None


def test_a_strand_beyond_its_radius_is_pulled_back(groom: Groom, scene: PosedScene) -> None:
    """By the formula: half m k times the square of the distance beyond a |x - c| at rest + b."""
    energy, hair = energy_of(groom), pulled(groom).requires_grad_()
    total = energy.total(hair, scene)
    (gradient,) = torch.autograd.grad(total, hair)
    strand = tied_strand(groom)
    assert (gradient[0, strand, -6:, 1] > 0).all()
    tails = tails_of(groom)
    assert tails is not None
    distance = tails.from_centre(hair.detach())[0].norm(dim=-1)
    excess = (distance - 1.5 * tails.rest_distance - 0.002).clamp(min=0)
    mass = energy.rest.mass.flatten()[tails.vertex]
    assert float(total.detach()) == pytest.approx(float((1000.0 * mass * excess**2).sum()), rel=1e-5)
    # All forces between strands: none is left on the whole.
    assert float(gradient.sum(dim=(0, 1, 2)).norm()) < 1e-5 * float(gradient.norm())


def test_its_gradient_is_that_of_differences(groom: Groom, scene: PosedScene) -> None:
    groom = replace(groom, rest_strands=groom.rest_strands.double())
    scene = PosedScene(groom, groom.rest_strands[None], scene.surface)
    energy, generator, hair = energy_of(groom), torch.Generator().manual_seed(0), pulled(groom)
    direction = torch.randn(hair.shape, generator=generator, dtype=torch.float64)
    moved = hair.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(energy.total(moved, scene), moved)
    step = 1e-6
    up, down = (float(energy.total(hair + sign * step * direction, scene)) for sign in (1, -1))
    assert (up - down) / (2 * step) == pytest.approx(float((gradient * direction).sum()), rel=1e-4)


def test_terms_of_a_design_have_it_where_hair_is_tied(groom: Groom, body: BodyModel) -> None:
    names = [term.name for term in hair_terms("rod", sag_free_rest(groom, body))]
    assert names[-1] == "cohesion"
