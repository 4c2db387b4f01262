"""Passes over single strands: against the energy in torch, and where they end."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from quaffure.body import BodyModel
from quaffure.config import STANDARD_GRAVITY
from quaffure.energies import Cohesion, HairEnergy, hair_terms, sag_free_rest
from quaffure.energies.gravity import NO_ACCELERATION
from quaffure.hair import Groom
from quaffure.procedural import make_groom
from quaffure.scene import PosedScene
from quaffure.solvers import StrandDescent, StrandNewtonDraper, energy_and_gradient, step_control
from quaffure.solvers.step_control import StepControl
from quaffure.solvers.strand_kernels import DensityModel, Evaluation, model_surroundings, take_strands
from tests.scenes import HELD_EDGES, clip_scene, few_strands, half_held_groom, posed_scene, sphere_groom


def _pulled_inwards(scene: PosedScene) -> torch.Tensor:
    """Directions [s e 3] that lead into the sphere."""
    pulled = scene.director[0] - 1.1 * torch.nn.functional.normalize(scene.posed[0, :, 1:], dim=-1)
    return torch.nn.functional.normalize(pulled, dim=-1)


@pytest.mark.parametrize("groom", [sphere_groom(strands=20), half_held_groom()], ids=["free", "half held"])
def test_own_energy_and_gradient_are_those_of_the_terms(groom: Groom) -> None:
    scene = posed_scene(groom)
    energy = HairEnergy(scene.groom, terms=hair_terms("rod"))
    descent = StrandDescent(energy, scene, direction=_pulled_inwards(scene))
    own = energy.without("self_collision")
    total, gradient = energy_and_gradient(own, scene, descent.positions)
    assert float(energy.by_term(descent.positions, scene)["body_collision"]) > 0.01 * float(total)
    evaluated = descent._now  # what a pass starts from, up to date since its positions were asked for
    assert evaluated.energy.sum() == pytest.approx(float(total), rel=1e-4)
    found = torch.from_numpy(evaluated.gradient)[None].clone()
    found[:, :, 0] = 0
    torch.testing.assert_close(found, gradient, atol=1e-3 * float(gradient.abs().max()), rtol=1e-3)


def test_hair_around_a_strand_is_a_quadratic_model_of_its_density_energy() -> None:
    scene = posed_scene(sphere_groom(strands=300))
    energy = HairEnergy(scene.groom, terms=hair_terms("rod"))
    descent = StrandDescent(energy, scene, direction=_pulled_inwards(scene))
    descent.settle(2)
    descent._model_surroundings(descent._with_other_hair()[1], descent.history.damping)
    positions, around = descent.positions, descent._around
    assert torch.equal(torch.from_numpy(around.positions), positions[0])
    _, expected = energy_and_gradient(energy.only("self_collision"), scene, positions)
    expected[:, :, 0] = torch.from_numpy(around.gradient[:, 0])  # roots are left out there
    small = expected.norm(dim=-1) < 0.99 * torch.from_numpy(descent._most_force)[:, None]
    found = torch.from_numpy(around.gradient)[None]
    assert float(small.float().mean()) > 0.5
    assert float(found[small].norm()) > 0
    torch.testing.assert_close(found[small], expected[small], rtol=1e-3, atol=1e-3 * float(found[small].abs().max()))

    noise = 1e-3 * torch.randn(descent.direction.shape, generator=torch.Generator().manual_seed(4)).numpy()
    moved = StrandDescent(
        energy, scene, direction=torch.nn.functional.normalize(torch.from_numpy(descent.direction + noise), dim=-1)
    )
    for own, other in zip(moved._around, around):
        own[:] = other
    step = moved.positions[0].numpy() - around.positions
    model = (around.gradient * step).sum(axis=(1, 2)) + 0.5 * (around.stiffness[..., None] * step**2).sum(axis=(1, 2))
    assert moved._now.energy[:, 1] == pytest.approx(model, rel=1e-3, abs=1e-4 * float(np.abs(model).max()))


def _random(*shape: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def test_forces_of_the_model_are_limited_and_damping_stiffens_it() -> None:
    """Against the same formulas in numpy."""
    strands, vertices, distance = 7, 5, 0.002
    gradient, positions = _random(strands, vertices, 3, seed=0), _random(strands, vertices, 3, seed=1)
    gradient[0, 0] = 0.0
    most, damping = abs(_random(strands, seed=2)) + 1, abs(_random(strands, seed=3))
    weight = abs(_random(strands, vertices, seed=4))
    model = DensityModel(np.empty_like(gradient), np.empty_like(weight), np.empty_like(positions))
    model_surroundings(gradient, most, damping, weight, np.float32(distance), positions, model)
    size = np.linalg.norm(gradient, axis=-1)
    limited = np.minimum(size, most[:, None])
    assert (limited < size).any()
    assert (limited == size).any()
    expected = gradient * (limited / np.maximum(size, 1e-30))[..., None]
    np.testing.assert_allclose(model.gradient, expected, rtol=1e-5, atol=1e-6)
    stiffness = ((1 + damping[:, None]) * limited + damping[:, None] * weight) / distance
    np.testing.assert_allclose(model.stiffness, stiffness, rtol=1e-5)
    assert np.array_equal(model.positions, positions)


def test_only_strands_that_are_listed_are_taken() -> None:
    def evaluation(seed: int) -> Evaluation:
        energy = _random(6, 2, seed=seed).astype(np.float64)
        return Evaluation(
            _random(6, 4, 3, seed=seed), energy, _random(6, 4, 3, seed=seed + 1), _random(6, 4, 4, seed=seed + 2)
        )

    now, trial, before = evaluation(0), evaluation(10), evaluation(0)
    direction, other, kept = _random(6, 3, 3, seed=20), _random(6, 3, 3, seed=21), _random(6, 3, 3, seed=20)
    moved, taken = np.full(6, -1, np.float32), np.array([1, 4, 5])
    left = np.array([0, 2, 3])
    take_strands(taken, other, trial, direction, now, moved)
    for own, found, old in zip((*now, direction), (*trial, other), (*before, kept)):
        assert np.array_equal(own[taken], found[taken])
        assert np.array_equal(own[left], old[left])
    displacement = np.linalg.norm(trial.positions - before.positions, axis=-1).max(axis=-1)
    np.testing.assert_allclose(moved[taken], displacement[taken], rtol=1e-5)
    assert (moved[left] == -1).all()


def test_contact_is_resolved_outwards_and_held_edges_stay() -> None:
    scene = posed_scene(half_held_groom())
    energy, inwards = HairEnergy(scene.groom, terms=hair_terms("rod")), _pulled_inwards(scene)
    descent = StrandDescent(energy, scene, direction=inwards)
    before = descent.positions[0].norm(dim=-1)
    descent.resolve_contact(1.0)
    after, rotated = descent.positions[0].norm(dim=-1), torch.from_numpy(descent.direction) - inwards
    margin = energy.rest.collision_margin[1::2, 1:]
    assert float((before[1::2, 1:] - 0.1 - margin).min()) < -0.02
    assert float((after[1::2, 1:] - 0.1 - margin).min()) > -0.01  # edges keep their lengths
    assert float(rotated[::2, :HELD_EDGES].abs().max()) == 0.0
    assert float(rotated[1::2, :HELD_EDGES].abs().max()) > 0.5


@pytest.mark.parametrize("groom", [sphere_groom(strands=20), half_held_groom()], ids=["free", "half held"])
def test_near_rest_one_pass_is_exact(groom: Groom) -> None:
    """Without load the model of a strand that is bent a little has its minimum at rest: joints, root and goals."""
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    scene = posed_scene(groom, groom.rest_strands[None] @ turn)
    noise = torch.randn(scene.director[0].shape, generator=torch.Generator().manual_seed(2))
    bent = torch.nn.functional.normalize(scene.director[0] + 0.01 * noise, dim=-1)
    descent = StrandDescent(HairEnergy(groom, terms=hair_terms("rod", acceleration=NO_ACCELERATION)), scene, None, bent)
    before = (bent - scene.director[0]).norm(dim=-1)
    descent.run_free(1)
    after = (torch.from_numpy(descent.direction) - scene.director[0]).norm(dim=-1)
    assert float((after / before.mean()).max()) < 0.1


def test_settling_ends_where_the_energy_was_lowest() -> None:
    """Of dense hair that hardly yields to the hair around it, too, so that the third pass raises the energy by far more
    than processors differ."""
    scene = posed_scene(sphere_groom(strands=600))
    energy = HairEnergy(scene.groom, terms=hair_terms("rod"))
    descent, moving = (StrandDescent(energy, scene, StepControl(yield_distance=1.0)) for _ in range(2))
    rises = []
    for _ in range(6):
        before, moving_before = (float(energy.total(of.positions, scene)) for of in (descent, moving))
        descent.settle(1)
        moving.run(1)
        after = float(energy.total(descent.positions, scene))
        rises.append(float(energy.total(moving.positions, scene)) - moving_before)
        assert after <= before
        assert after == pytest.approx(descent.lowest_energy, rel=1e-4)
    assert rises[2] > 0.1 * abs(descent.lowest_energy)
    assert moving.history.damping.max() > 0


def test_steps_that_reverse_are_shortened_to_end_lower(body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = clip_scene(make_groom("long_straight", body), body, "bow", slice(60, 61))
    draper = StrandNewtonDraper()
    energy = draper.energy_of(scene)

    def settled() -> float:
        return float(energy.per_vertex(energy.total(draper.drape(scene), scene))[0])

    with_shortened_steps = settled()
    monkeypatch.setattr(step_control, "secant_shares", lambda step, before: np.ones(len(step), np.float32))
    assert with_shortened_steps < settled() - 5e-4


def test_the_lower_of_two_starts_is_taken_strand_by_strand_and_tails_stay_whole() -> None:
    scene = posed_scene(half_held_groom())
    energy = HairEnergy(scene.groom, terms=hair_terms("rod"))
    outwards, inwards = StrandDescent(energy, scene), StrandDescent(energy, scene, direction=_pulled_inwards(scene))
    for strand in (0, 1, 5):
        inwards.direction[strand] = outwards.direction[strand]
        outwards.direction[strand] = _pulled_inwards(scene)[strand]
    lower = outwards.direction.copy()
    lower[[1, 5]] = inwards.direction[[1, 5]]  # strand 0 is held, and the other held ones are lower outwards
    outwards.take_lower(inwards)
    np.testing.assert_array_equal(outwards.direction, lower)
    for strand in range(0, 20, 2):
        outwards.direction[strand] = _pulled_inwards(scene)[strand]
    lower[::2] = inwards.direction[::2]  # all held strands are lower together there
    outwards._forget()
    outwards.take_lower(inwards)
    np.testing.assert_array_equal(outwards.direction, lower)


def test_cohesion_decides_with_the_own_energy_which_tail_is_taken(body: BodyModel) -> None:
    """Strands of a tail that fall without it have less energy of their own and more of cohesion."""
    scene = clip_scene(few_strands(body, "ponytail"), body, "bow", slice(60, 61))
    *terms, cohesion = hair_terms("rod", sag_free_rest(scene.groom, body))
    assert isinstance(cohesion, Cohesion)
    held = (scene.groom.goal_weight > 0).any(dim=1).numpy()
    for stiffness, is_taken in ((1e-6, True), (1e6, False)):
        energy = HairEnergy(scene.groom, terms=(*terms, replace(cohesion, stiffness=stiffness)))
        posed, fallen = (StrandDescent(energy, scene) for _ in range(2))
        alone = StrandDescent(HairEnergy(scene.groom, terms=tuple(terms)), scene)
        alone.run_with_contact(4)
        fallen.direction[:] = alone.direction
        posed.take_lower(fallen)
        assert np.array_equal(posed.direction[held], alone.direction[held]) == is_taken


@pytest.mark.parametrize(("pull", "unit"), [(0.0, 1.0), (0.5, 1.0), (8.0, 8.0)])
def test_forces_between_strands_are_limited_in_units_of_their_weight(pull: float, unit: float) -> None:
    """Heavier hair presses harder; hair without weight still pushes apart."""
    scene = posed_scene(sphere_groom(strands=5))
    usual, other = (
        StrandDescent(
            HairEnergy(scene.groom, terms=hair_terms("rod", acceleration=(0.0, share * STANDARD_GRAVITY, 0.0))), scene
        )
        for share in (1.0, pull)
    )
    assert other._most_force == pytest.approx(unit * usual._most_force, rel=1e-5)
    assert usual._most_force == pytest.approx(10 * STANDARD_GRAVITY * HairEnergy(scene.groom).rest.mass.sum(1).numpy())


def test_a_direction_that_is_not_finite_is_refused() -> None:
    scene = posed_scene(sphere_groom(strands=3))
    direction = scene.director[0].clone()
    direction[1, 2] = float("nan")
    with pytest.raises(ValueError, match="finite"):
        StrandDescent(HairEnergy(scene.groom, terms=hair_terms("rod")), scene, direction=direction)
