from dataclasses import replace
from unittest import mock

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.backend import Backend
from quaffure.baselines import PosedDraper
from quaffure.benchmark import accelerations, intersection_percent, measure, vertices_from_head
from quaffure.benchmark.metrics import metrics
from quaffure.body import bundled_clip, load_body
from quaffure.drape_motion import drape_motion
from quaffure.drapers import DRAPERS, GROOMGEN, LIVE_DRAPERS, elastic_model_of, make_draper
from quaffure.energies import HairEnergy, equilibrium_vectors
from quaffure.energies.by_name import MODIFIED_COSSERAT, ROD
from quaffure.energies.rest_state import rest_state
from quaffure.geometry import integrate_directions
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import AdamDraper

BODY = load_body()
GROOM = make_groom("long_straight", BODY).select(torch.arange(0, 2400, 40))


def turned_scene() -> Scene:
    return Scene(GROOM, BodyBatch(BODY, bundled_clip("neck_turn", BODY).body_pose[[20, 65]], torch.zeros(2, 10)))


def test_adam_finds_the_closed_form_where_nothing_touches() -> None:
    material = HairMaterial(k_body_collision=0.0, k_self_collision=0.0)
    scene = turned_scene()
    rest = rest_state(GROOM.rest_strands, material)
    sag = equilibrium_vectors(scene.director, rest.rest_length, rest.mass_beyond, material.k_cosserat)
    expected = integrate_directions(scene.posed[:, :, 0], sag, rest.rest_length)
    # Adam starts from the sag itself: shake it, to make the solver work.
    with mock.patch("quaffure.solvers.descent.equilibrium_vectors", return_value=sag + 0.3 * torch.randn(sag.shape)):
        draped, report = AdamDraper(material, steps=200).solve(scene)
    assert report.relative_gradient < 0.02
    torch.testing.assert_close(draped, expected, atol=5e-4, rtol=0)


def test_adam_takes_hair_out_of_the_body_and_lowers_the_energy() -> None:
    scene = turned_scene()
    draped, report = AdamDraper(steps=150).solve(scene)
    energy = HairEnergy(GROOM)
    before, after = (metrics(x, scene, energy) for x in (scene.posed, draped))
    assert before["body_intersection_percent"].min() > 1
    assert after["body_intersection_percent"].max() < 0.3
    assert (after["energy"] < before["energy"]).all()
    assert after["length_error_percent_max"].max() < 0.01
    assert report.iterations == 150


def test_figures_of_a_rigidly_posed_groom() -> None:
    scene = turned_scene()
    figures = metrics(scene.posed, scene, HairEnergy(GROOM), reference=scene.posed + 0.01)
    assert figures["orientation_error_deg"].max() < 0.1
    assert figures["length_error_percent"].max() < 0.01
    torch.testing.assert_close(figures["distance_mm"], torch.full((2,), 10 * 3**0.5))
    raised = HairEnergy(GROOM).by_term(scene.posed + 0.01, scene)
    rest = HairEnergy(GROOM).by_term(scene.posed, scene)
    excess = sum(rest.values()) - sum(raised.values())
    torch.testing.assert_close(figures["excess_energy"], HairEnergy(GROOM).per_vertex(excess), rtol=1e-3, atol=1e-5)


def test_intersections_count_vertices_inside_and_no_roots() -> None:
    scene = Scene(GROOM, BodyBatch(BODY, torch.zeros(1, 81), torch.zeros(1, 10)))
    assert intersection_percent(scene.posed, scene).item() < 0.2
    pushed = scene.posed.clone()
    head = scene.bodies.posed.joint_positions[0, BODY.joint_names.index("Head")] + torch.tensor([0, 0, 0.05])
    pushed[:, :15, 1:] = head  # a quarter of the 60 strands, all but their roots
    assert intersection_percent(pushed, scene).item() == pytest.approx(25, abs=0.2)


def test_measure_of_a_motion_and_its_own_reference() -> None:
    motion = bundled_clip("nod", BODY).frames("0:12")
    posed = drape_motion(PosedDraper(), GROOM, BODY, motion, torch.zeros(10))
    trembling = replace(posed, strands=posed.strands.copy())
    trembling.strands[::2, :, 1:, 0] += 1e-3  # to and fro by 1 mm: a second difference of 2 mm at 23 of 24 vertices
    bodies = BodyBatch(BODY, torch.from_numpy(trembling.body_pose), torch.zeros(12, 10))
    from_head = vertices_from_head(torch.from_numpy(trembling.strands), bodies)
    assert float(accelerations(from_head).mean()) == pytest.approx(2e-3 * 23 / 24, rel=0.1)
    draped, merely_posed = measure(posed, GROOM, BODY, reference=posed)
    assert draped["excess_energy"].abs().max() == 0
    assert draped["distance_mm"].max() == 0
    torch.testing.assert_close(draped["jitter"], torch.ones(12))
    for name, figure in merely_posed.items():
        torch.testing.assert_close(figure, draped[name])
    assert posed.meta["draper"] == "posed"
    assert len(posed) == 12


def test_compiled_contact_is_that_of_the_reference_on_a_posed_body() -> None:
    scene = turned_scene()
    compiled, reference = (HairEnergy(GROOM, backend=backend).by_term(scene.posed, scene) for backend in Backend)
    assert compiled["body_collision"].min() > 0
    torch.testing.assert_close(compiled["body_collision"], reference["body_collision"], rtol=1e-4, atol=0)


def test_a_reference_of_another_motion_is_refused() -> None:
    turn, bow = (
        drape_motion(PosedDraper(), GROOM, BODY, bundled_clip(name, BODY).frames("20:24"), torch.zeros(10))
        for name in ("neck_turn", "bow")
    )
    with pytest.raises(InputError, match="body_pose"):
        measure(turn, GROOM, BODY, reference=bow)


def test_every_name_of_the_list_makes_its_draper() -> None:
    """`groomgen` needs weights of the user."""
    for name in DRAPERS:
        if name != GROOMGEN:
            assert make_draper(name).name == name
    assert {*LIVE_DRAPERS} < {*DRAPERS}
    with pytest.raises(InputError, match="draper: expected one of"):
        make_draper("comb")
    with pytest.raises(InputError, match="draper neural: expected no material"):
        make_draper("neural", HairMaterial())
    with pytest.raises(InputError, match="draper groomgen: expected the file of its weights"):
        make_draper(GROOMGEN)


def test_the_elastic_model_is_the_papers_for_what_the_paper_has_and_the_rod_for_all_others() -> None:
    assert {name for name in DRAPERS if elastic_model_of(name) == MODIFIED_COSSERAT} == {"xpbd_paper", GROOMGEN}
    assert {name for name in DRAPERS if elastic_model_of(name) == ROD} == {*DRAPERS} - {"xpbd_paper", GROOMGEN}
    assert elastic_model_of("neural", "paper") == MODIFIED_COSSERAT
