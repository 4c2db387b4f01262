"""Drapes by Newton's method on single strands."""

from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.benchmark import intersection_percent
from quaffure.body import BodyModel
from quaffure.energies import HairEnergy, Loading, hair_terms, sag_free_rest
from quaffure.model import load_model
from quaffure.solvers import (
    NEAR_REST,
    DesignSolver,
    LbfgsDraper,
    SettledDraper,
    StrandDescent,
    StrandNewtonDraper,
    StrandNewtonSetting,
    solver,
)
from tests.scenes import HELD_EDGES, clip_scene, few_strands, half_held_groom, posed_scene, sphere_groom, upright_scene


def test_hair_on_a_head_that_stays_upright_does_not_fall_through_it(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, "curly_bob", 300), body, "neck_turn", slice(60, 61))
    draper = StrandNewtonDraper()
    energy, setting = draper.energy_of(scene), draper.setting
    fallen = StrandDescent(energy, scene.sample(0), setting.control)
    fallen.run_free(setting.free_passes)
    fallen.resolve_contact(setting.resolved_share)
    fallen.run_with_contact(setting.contact_passes)
    passes = setting.passes - setting.free_passes - setting.contact_passes
    draper._settle_in_rounds(fallen, passes, setting.rounds)
    gained = fallen.lowest_energy - draper.descend(energy, scene.sample(0)).lowest_energy
    assert gained > 0.002 * energy.per_vertex_unit


def test_held_edges_keep_their_posed_directions_and_free_hair_falls() -> None:
    groom = half_held_groom()
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    scene = posed_scene(groom, groom.rest_strands[None] @ turn)
    descent = StrandDescent(HairEnergy(groom, terms=hair_terms("rod")), scene)
    start = descent.own_energy
    assert descent.has_goals
    descent.resolve_contact(1.0)
    descent.settle(10)
    assert descent.own_energy < start
    rotated = 1 - (torch.from_numpy(descent.direction) * scene.director[0]).sum(dim=-1)
    assert float(rotated[::2, :HELD_EDGES].max()) < 1e-3
    assert float(rotated[1::2, :HELD_EDGES].mean()) > 0.1
    assert float(rotated[::2, HELD_EDGES + 2 :].mean()) > 0.1


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


def test_a_setting_needs_as_many_passes_as_its_parts() -> None:
    StrandNewtonSetting(passes=4)
    with pytest.raises(ValueError, match="at least 4, free and contact passes, found 3"):
        StrandNewtonSetting(passes=3)
    for none in ({"rounds": 0}, {"tied_factor": 0}):
        with pytest.raises(ValueError, match="at least 1"):
            StrandNewtonSetting(**none)


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
