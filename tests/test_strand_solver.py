"""Newton's method on single strands: elimination against a dense solve, passes against the energy in torch, drapes."""

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.benchmark import intersection_percent
from quaffure.benchmark.appearance import jumps
from quaffure.body import BodyModel, bundled_clip
from quaffure.config import STANDARD_GRAVITY
from quaffure.drape_motion import drape_motion
from quaffure.energies import HairEnergy, Loading, hair_terms, sag_free_rest
from quaffure.energies.gravity import NO_ACCELERATION
from quaffure.hair import Groom
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, PosedScene, Scene
from quaffure.solvers import (
    NEAR_REST,
    CoherentDraper,
    CoherentSetting,
    DesignSolver,
    LbfgsDraper,
    SettledDraper,
    StrandDescent,
    StrandNewtonDraper,
    StrandNewtonSetting,
    energy_and_gradient,
    solver,
    strand_descent,
)
from quaffure.solvers.strand_descent import StepControl
from quaffure.solvers.strand_kernels import DensityModel, Evaluation, model_surroundings, take_strands
from quaffure.solvers.strand_recursion import LEAST_ALIGNMENT, StrandModel, newton_rotations
from tests.scenes import clip_scene, few_strands, posed_scene, sphere_groom, upright_scene
from tests.strand_reference import newton_rotations_reference

CONTACT = 10.0  # k_bc [J/m^3]


def _unit(generator: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = generator.standard_normal((*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _random_model(strands: int, edges: int = 23) -> StrandModel:
    generator = np.random.default_rng(0)
    direction = _unit(generator, strands, 1) + 0.5 * _unit(generator, strands, edges).cumsum(axis=1)
    depth = generator.uniform(0, 0.01, (strands, edges + 1, 1)) * (np.arange(edges + 1) % 3 > 0)[:, None]
    vertices = (strands, edges + 1)
    fields = StrandModel(
        direction=direction / np.linalg.norm(direction, axis=-1, keepdims=True),
        root_direction=_unit(generator, strands),
        length=generator.uniform(5e-3, 15e-3, (strands, edges)),
        bending=generator.uniform(5e-7, 5e-6, (strands, edges)),
        twisting=generator.uniform(5e-7, 5e-6, (strands, edges)),
        goal=np.where(generator.random((strands, edges)) < 0.1, 1e-5, 0.0),
        gradient=1e-6 * generator.standard_normal((*vertices, 3)),
        contact=np.concatenate([_unit(generator, *vertices), depth], axis=-1),
        around_gradient=1e-6 * generator.standard_normal((*vertices, 3)),
        around_stiffness=generator.uniform(0, 1e-2, vertices),
    )
    return StrandModel(*(np.ascontiguousarray(field, np.float32) for field in fields))


@pytest.mark.parametrize("strands", [1, 8, 21])
def test_elimination_solves_the_dense_system(strands: int) -> None:
    model = _random_model(strands)
    rotation = np.full((strands, 23, 3), np.nan, np.float32)
    newton_rotations(model, np.float32(CONTACT), np.arange(strands), rotation)
    expected = newton_rotations_reference(model, CONTACT)
    error = (torch.from_numpy(rotation) - expected).norm(dim=-1) / expected.norm(dim=-1).mean()
    assert float(error.max()) < 1e-4


def test_elimination_solves_the_dense_system_where_an_edge_folds_back() -> None:
    model = _random_model(8)
    folded = 0.05 * _unit(np.random.default_rng(1), 8) - model.direction[:, 4]
    model.direction[:, 5] = folded / np.linalg.norm(folded, axis=-1, keepdims=True)
    assert (1 + (model.direction[:, 4] * model.direction[:, 5]).sum(-1) < LEAST_ALIGNMENT).all()
    rotation = np.empty((8, 23, 3), np.float32)
    newton_rotations(model, np.float32(CONTACT), np.arange(8), rotation)
    expected = newton_rotations_reference(model, CONTACT)
    error = (torch.from_numpy(rotation) - expected).norm(dim=-1) / expected.norm(dim=-1).mean()
    assert float(error.max()) < 1e-4


def test_only_the_strands_listed_are_solved() -> None:
    model = _random_model(12)
    rotation = np.full((12, 23, 3), np.nan, np.float32)
    newton_rotations(model, np.float32(CONTACT), np.array([3, 7]), rotation)
    solved = ~np.isnan(rotation).any(axis=(1, 2))
    assert solved.nonzero()[0].tolist() == [3, 7]


HELD = 12  # edges from the root


def _half_held() -> Groom:
    """Strands round a sphere, every second of which is held for half its length."""
    groom = sphere_groom(strands=20)
    weight = torch.zeros_like(groom.rest_lengths)
    weight[::2, :HELD] = 1e-3
    return replace(groom, goal_weight=weight)


def _pulled_inwards(scene: PosedScene) -> torch.Tensor:
    """Directions [s e 3] that lead into the sphere."""
    pulled = scene.director[0] - 1.1 * torch.nn.functional.normalize(scene.posed[0, :, 1:], dim=-1)
    return torch.nn.functional.normalize(pulled, dim=-1)


@pytest.mark.parametrize("groom", [sphere_groom(strands=20), _half_held()], ids=["free", "half held"])
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
    descent._model_surroundings(descent._with_other_hair()[1], descent.strand_damping)
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
    scene = posed_scene(_half_held())
    energy, inwards = HairEnergy(scene.groom, terms=hair_terms("rod")), _pulled_inwards(scene)
    descent = StrandDescent(energy, scene, direction=inwards)
    before = descent.positions[0].norm(dim=-1)
    descent.resolve_contact(1.0)
    after, rotated = descent.positions[0].norm(dim=-1), torch.from_numpy(descent.direction) - inwards
    margin = energy.rest.collision_margin[1::2, 1:]
    assert float((before[1::2, 1:] - 0.1 - margin).min()) < -0.02
    assert float((after[1::2, 1:] - 0.1 - margin).min()) > -0.01  # edges keep their lengths
    assert float(rotated[::2, :HELD].abs().max()) == 0.0
    assert float(rotated[1::2, :HELD].abs().max()) > 0.5


@pytest.mark.parametrize("groom", [sphere_groom(strands=20), _half_held()], ids=["free", "half held"])
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
    """Of hair so dense that passes raise the energy, too: each call ends no higher than it began."""
    scene = posed_scene(sphere_groom(strands=300))
    energy = HairEnergy(scene.groom, terms=hair_terms("rod"))
    descent = StrandDescent(energy, scene, StepControl(yield_distance=0.1), _pulled_inwards(scene))
    for _ in range(6):
        before = float(energy.total(descent.positions, scene))
        descent.settle(2)
        after = float(energy.total(descent.positions, scene))
        assert after <= before
        assert after == pytest.approx(descent.settled_energy, rel=1e-4)


def test_dense_hair_settles_lower_where_swings_are_shortened(body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = clip_scene(make_groom("long_straight", body), body, "bow", slice(60, 61))
    draper = StrandNewtonDraper()
    energy = draper.energy_of(scene)

    def settled() -> float:
        return float(energy.per_vertex(energy.total(draper.drape(scene), scene))[0])

    with_swings_shortened = settled()
    monkeypatch.setattr(strand_descent, "secant_shares", lambda step, before: np.ones(len(step), np.float32))
    assert with_swings_shortened < settled() - 5e-4


def test_the_lower_of_two_starts_is_taken_strand_by_strand_and_tails_stay_whole() -> None:
    scene = posed_scene(_half_held())
    energy = HairEnergy(scene.groom, terms=hair_terms("rod"))
    outwards, inwards = StrandDescent(energy, scene), StrandDescent(energy, scene, direction=_pulled_inwards(scene))
    for strand in (0, 1, 5):
        inwards.direction[strand] = outwards.direction[strand]
        outwards.direction[strand] = _pulled_inwards(scene)[strand]
    lower = outwards.direction.copy()
    lower[[1, 5]] = inwards.direction[[1, 5]]  # strand 0 is held, and the other held ones are lower outwards
    outwards.take_lower(inwards)
    np.testing.assert_array_equal(outwards.direction, lower)


def test_hair_on_a_head_that_stays_upright_does_not_fall_through_it(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, "curly_bob", 300), body, "neck_turn", slice(60, 61))
    draper = StrandNewtonDraper()
    energy, setting = draper.energy_of(scene), draper.setting
    fallen = StrandDescent(energy, scene.sample(0), setting.control)
    fallen.run_free(setting.free_passes)
    fallen.resolve_contact(setting.resolved_share)
    fallen.run_with_contact(setting.contact_passes)
    draper._settle_in_rounds(fallen, 15, setting.rounds)
    gained = fallen.settled_energy - draper.descend(energy, scene.sample(0)).settled_energy
    assert gained > 0.002 * energy.per_vertex_unit


def test_held_edges_keep_their_posed_directions_and_free_hair_falls() -> None:
    groom = _half_held()
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    scene = posed_scene(groom, groom.rest_strands[None] @ turn)
    descent = StrandDescent(HairEnergy(groom, terms=hair_terms("rod")), scene)
    start = descent.own_energy
    assert descent.has_goals
    descent.resolve_contact(1.0)
    descent.settle(10)
    assert descent.own_energy < start
    rotated = 1 - (torch.from_numpy(descent.direction) * scene.director[0]).sum(dim=-1)
    assert float(rotated[::2, :HELD].max()) < 1e-3
    assert float(rotated[1::2, :HELD].mean()) > 0.1
    assert float(rotated[::2, HELD + 2 :].mean()) > 0.1


@pytest.mark.parametrize("style", ["long_straight", "bowl_cut"])
def test_the_design_stays(body: BodyModel, style: str) -> None:
    """Also where hair that has fallen ends lower, as a thin bowl cut."""
    scene = upright_scene(few_strands(body, style), body)
    draped = StrandNewtonDraper().drape(scene)
    assert float((draped - scene.posed).norm(dim=-1).max()) < 1e-3


def test_drapes_end_as_low_as_those_of_lbfgs_and_keep_lengths(body: BodyModel) -> None:
    groom = few_strands(body, count=30)
    scene = clip_scene(groom, body, "bow", slice(60, 61))
    terms = hair_terms("rod", sag_free_rest(groom, body))
    energy = HairEnergy(groom, terms=terms)
    draped, report = StrandNewtonDraper(terms=terms).solve(scene)
    reference = LbfgsDraper(evaluations=150, terms=terms).drape(scene)
    excess = energy.per_vertex(energy.total(draped, scene) - energy.total(reference, scene))
    assert float(excess) < 0.02
    assert report.energy == pytest.approx(float(energy.total(draped, scene)), rel=1e-5)
    lengths = draped.diff(dim=2).norm(dim=-1)
    torch.testing.assert_close(lengths, energy.rest.rest_length[None], rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(draped[:, :, 0], scene.posed[:, :, 0])


@pytest.mark.slow
def test_a_tail_stays_a_tail_and_out_of_the_head(body: BodyModel) -> None:
    """In a bow: without cohesion its strands lie all around the head."""
    scene = clip_scene(few_strands(body, "ponytail", count=600), body, "bow", slice(60, 61))
    newton = StrandNewtonDraper()
    draped = newton.drape(scene)
    assert float(intersection_percent(draped, scene)) < 0.01
    energy = newton.energy_of(scene)
    assert float(energy.metrics(draped, scene)["cohesion"]) < 2e-3
    apart = StrandNewtonDraper(terms=energy.without("cohesion").terms).drape(scene)
    assert float(energy.metrics(apart, scene)["cohesion"]) > 1e-2


@pytest.mark.parametrize("name", ["lbfgs", "xpbd"])
def test_a_solver_without_terms_keeps_the_design(body: BodyModel, name: str) -> None:
    """As `strand_newton` does: the paper's energy lets upright hair sag."""
    scene = upright_scene(few_strands(body, "bob", count=60), body)
    own, paper = (solver(name, terms=terms).drape(scene) for terms in (None, hair_terms()))
    assert float((own - scene.posed).norm(dim=-1).mean()) < 1e-3
    assert float((paper - scene.posed).norm(dim=-1).mean()) > 3e-3


def test_a_design_solver_reads_loading_and_start(body: BodyModel) -> None:
    """From a settled drape Newton's method stays near it; under another loading hair hangs elsewhere."""
    scene = clip_scene(few_strands(body, "bob"), body, "neck_turn", slice(20, 21))
    own = DesignSolver("strand_newton", HairMaterial())
    settled = own.drape(scene)
    again = DesignSolver("strand_newton", HairMaterial(), start=StrandNewtonDraper()).drape(scene)
    assert float((again - settled).norm(dim=-1).mean()) < 5e-4
    leaning = own.with_loading(Loading(1.0, (0.0, -5.0, -8.0))).drape(scene)
    assert float((leaning - settled)[..., 1].mean()) < -2e-3
    with pytest.raises(InputError, match="start from a drape"):
        DesignSolver("posed", HairMaterial(), start=StrandNewtonDraper()).drape(scene)


def test_more_passes_never_raise_the_energy(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, "bob"), body, "bow", slice(60, 61))
    newton = StrandNewtonDraper()
    energy = newton.energy_of(scene)
    start = newton.drape(scene)
    for passes in (1, 3):
        settled = newton.settle(scene, start, passes)
        # Positions are float32: integrated anew they differ in the last digits.
        assert float(energy.per_vertex(energy.total(settled, scene) - energy.total(start, scene))) < 1e-4
    posed = SettledDraper(LbfgsDraper(evaluations=5), newton, 4)
    assert float(energy.total(posed.drape(scene), scene)) < float(energy.total(scene.posed, scene))


def test_hair_near_its_rest_settles_lower_in_few_passes(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, "ponytail", 600), body, "neck_turn", slice(60, 61))
    start, energy = load_model().draper.drape(scene), StrandNewtonDraper().energy_of(scene)
    near, usual = (
        energy.total(StrandNewtonDraper(setting=setting).settle(scene, start, 3), scene)
        for setting in (NEAR_REST, StrandNewtonSetting())
    )
    assert float(energy.per_vertex(near - usual)) < -0.002


def test_clips_follow_the_last_frame(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body), body, "neck_turn", slice(20, 26))
    setting = CoherentSetting(max_frame_displacement=0.02)
    follower = CoherentDraper(setting=setting)
    draped = torch.cat([follower.drape(_part(scene, frame)) for frame in range(6)])
    tips, roots, posed = draped[:, :, -1], draped[:, :, 0], scene.posed[:, :, -1]
    own = tips.diff(dim=0).norm(dim=-1)
    carried = torch.maximum(roots.diff(dim=0).norm(dim=-1), posed.diff(dim=0).norm(dim=-1))
    assert float((own - carried).max()) < setting.max_frame_displacement + 0.01
    energy = follower.draper.energy_of(scene)
    assert float(energy.per_vertex(energy.total(draped, scene)).max()) < 0.0
    together = CoherentDraper(setting=setting).drape(scene)
    assert torch.equal(together, draped)


def test_hair_does_not_sweep_around_a_head_that_turns_fast(body: BodyModel) -> None:
    """Hanging from a bowed head that is shaken: far from where it was posed, so the head moves it farther."""
    pose = bundled_clip("bow", body).body_pose[60]
    poses = pose.repeat(5, 1)
    poses[:, 3 * body.joint_names.index("Head") + 2] += 0.3 * torch.arange(5)
    scene = Scene(few_strands(body), BodyBatch(body, poses, torch.zeros(5, 10)))
    limited, unlimited = (
        float(jumps(CoherentDraper(setting=setting).drape(scene), scene.posed).max())
        for setting in (CoherentSetting(), CoherentSetting(max_head_sweep=1.0))
    )
    assert limited < 0.05 < unlimited


def _part(scene: Scene, frame: int) -> Scene:
    return Scene(scene.groom, scene.bodies.rows(slice(frame, frame + 1)))


def test_a_cut_in_the_motion_starts_anew(body: BodyModel) -> None:
    groom = few_strands(body, count=20)
    bowed, upright = clip_scene(groom, body, "bow", slice(60, 61)), upright_scene(groom, body)
    follower = CoherentDraper()
    follower.drape(bowed)
    torch.testing.assert_close(follower.drape(upright), StrandNewtonDraper().drape(upright))


def test_a_motion_is_draped_the_same_whatever_was_draped_before(body: BodyModel) -> None:
    """The bow has just begun: near enough to upright hair for its first frame to follow."""
    groom = few_strands(body, count=20)
    motion = bundled_clip("bow", body).frames("14:16")
    follower = CoherentDraper()
    once = drape_motion(follower, groom, body, motion, torch.zeros(10)).strands
    again = drape_motion(follower, groom, body, motion, torch.zeros(10)).strands
    continued = drape_motion(follower, groom, body, motion, torch.zeros(10), continues=True).strands
    assert np.array_equal(again, once)
    assert not np.array_equal(continued, once)


@pytest.mark.parametrize(("step", "passes", "moved"), [(1, (2, 4), 0.038), (4, (8, 16), 0.152)])
def test_limits_of_a_frame_grow_with_its_time(
    step: int, passes: tuple[int, int], moved: float, body: BodyModel
) -> None:
    follower = CoherentDraper()
    motion = bundled_clip("neck_turn", body).frames(f"30:34:{step}")
    drape_motion(follower, few_strands(body, count=5), body, motion, torch.zeros(10))
    setting = follower.setting.over(follower.frame_seconds)
    assert (setting.passes, setting.max_passes) == passes
    assert setting.max_frame_displacement == pytest.approx(moved)
    assert setting.max_head_sweep == pytest.approx(step * follower.setting.max_head_sweep)
    assert setting.max_pass_displacement == follower.setting.max_pass_displacement


def test_frames_of_a_short_time_keep_the_passes_that_damping_compares() -> None:
    setting = CoherentSetting().over(1 / 60)
    assert (setting.passes, setting.max_passes) == (2, 2)
    assert setting.max_frame_displacement == pytest.approx(0.019)


def test_hair_falls_no_further_behind_where_frames_are_left_out(body: BodyModel) -> None:
    groom, shape = few_strands(body), torch.zeros(10)
    motion = bundled_clip("neck_turn", body).frames("20:53")
    whole = torch.from_numpy(drape_motion(CoherentDraper(), groom, body, motion, shape).strands)[::4]
    every_fourth = motion.frames("::4")
    scaled = torch.from_numpy(drape_motion(CoherentDraper(), groom, body, every_fourth, shape).strands)
    as_at_30 = drape_motion(CoherentDraper(), groom, body, replace(every_fourth, fps=30.0), shape).strands
    behind = [float((hair - whole)[:, :, -1].norm(dim=-1).mean()) for hair in (scaled, torch.from_numpy(as_at_30))]
    assert behind[0] < 0.7 * behind[1]


def test_frames_far_apart_are_settled_one_by_one(body: BodyModel) -> None:
    groom, shape = few_strands(body, count=10), torch.zeros(10)
    motion = replace(bundled_clip("neck_turn", body).frames("20:22"), fps=1.9)
    found = drape_motion(CoherentDraper(), groom, body, motion, shape).strands
    assert np.array_equal(found, drape_motion(StrandNewtonDraper(), groom, body, motion, shape).strands)


def test_clips_are_the_same_bits_with_any_number_of_threads(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, "bob"), body, "neck_turn", slice(30, 32))
    drapes = []
    threads = numba.get_num_threads()
    try:
        for count in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(count)
            drapes.append(CoherentDraper().drape(scene))
    finally:
        numba.set_num_threads(threads)
    assert torch.equal(*drapes)


def test_hair_swings_with_gravity_and_soft_hair_further(body: BodyModel) -> None:
    groom = few_strands(body)
    scene = upright_scene(groom, body)
    design = sag_free_rest(groom, body)
    swung = {}
    for stiffness in (0.3, 1.0, 3.0):
        terms = hair_terms("rod", design, stiffness, (4.0, 0.0, -9.0))
        moved = StrandNewtonDraper(terms=terms).drape(scene) - scene.posed
        swung[stiffness] = moved[0, :, -1].mean(dim=0)
    assert float(swung[1.0][0]) > 0.01
    assert float(swung[1.0][0]) > 2 * float(swung[1.0][1].abs())
    assert float(swung[0.3][0]) > float(swung[1.0][0]) > float(swung[3.0][0])


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


def test_a_setting_needs_as_many_passes_as_its_parts() -> None:
    StrandNewtonSetting(passes=4)
    with pytest.raises(ValueError, match="at least 4, free and contact passes, found 3"):
        StrandNewtonSetting(passes=3)
    for none in ({"rounds": 0}, {"tied_factor": 0}):
        with pytest.raises(ValueError, match="at least 1"):
            StrandNewtonSetting(**none)


def test_a_direction_that_is_not_finite_is_refused() -> None:
    scene = posed_scene(sphere_groom(strands=3))
    direction = scene.director[0].clone()
    direction[1, 2] = float("nan")
    with pytest.raises(ValueError, match="finite"):
        StrandDescent(HairEnergy(scene.groom, terms=hair_terms("rod")), scene, direction=direction)


def test_the_design_is_that_of_the_scenes_body(body: BodyModel) -> None:
    groom = few_strands(body, count=10)
    wider = replace(body, rest_vertices=1.02 * body.rest_vertices)
    newton = StrandNewtonDraper()
    first = newton.energy_of(upright_scene(groom, body))
    assert newton.energy_of(upright_scene(groom, body)) is first
    margin = newton.energy_of(upright_scene(groom, wider)).rest.collision_margin
    expected = sag_free_rest(groom, wider).collision_margin.float()
    torch.testing.assert_close(margin, expected)
    assert not torch.allclose(margin, first.rest.collision_margin)


def test_other_terms_and_scenes_without_a_body_are_refused() -> None:
    with pytest.raises(InputError, match="elastic model rod"):
        StrandNewtonDraper(terms=hair_terms())
    with pytest.raises(InputError, match="without a body model"):
        StrandNewtonDraper().drape(posed_scene(sphere_groom(strands=3)))
