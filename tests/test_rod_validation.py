"""The elastic models against theory. `docs/validation.md` holds the same comparisons at more sizes."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from benchmarks.rods.elastic_potentials import mass_spring, modified_cosserat
from benchmarks.rods.heavy_rod import REAL_HAIR_WEIGHT, HeavyRod
from benchmarks.rods.rod_validation import (
    Case,
    Curl,
    Sphere,
    above_plane,
    best_k_cosserat,
    closed_form_difference_mm,
    depths_in_margin,
    helix_compliance,
    modified_error_mm,
    resting_depth,
    rms_mm,
    rod_errors,
    settle_rod,
    settle_under_weight,
    stretch_percent,
)
from quaffure.config import HairMaterial

STRAIGHT, CURLY, HANGING_CURL = Case(0.25), Case(0.25, curl=Curl()), Case(0.25, -90.0, Curl())


def test_heavy_rod_agrees_with_an_independent_solution() -> None:
    tip = 1000 * HeavyRod(0.25).shape(np.array([0.25]))[0]
    np.testing.assert_allclose(tip, [35.0, 0.0, -236.1], atol=0.06)


def test_weak_load_bends_a_rod_as_a_beam() -> None:
    rod = HeavyRod(0.1, weight=1e-9)
    deflection = rod.shape(np.array([0.1]))[0, 2]
    assert deflection == pytest.approx(-1e-9 * 0.1**4 / (8 * 8e-9), rel=1e-4)


@pytest.mark.parametrize("case", [STRAIGHT, CURLY, HANGING_CURL], ids=["straight", "curly", "hanging curl"])
def test_unloaded_rod_keeps_its_rest_curve(case: Case) -> None:
    rod = case.rod()
    free = HeavyRod(rod.length, weight=1e-14, clamp=rod.clamp, rest_curvature=rod.rest_curvature)
    np.testing.assert_allclose(free.shape(case.arc_length(9)), case.strand(9).numpy(), atol=1e-7)


@pytest.mark.parametrize("case", [STRAIGHT, CURLY, HANGING_CURL], ids=["straight", "curly", "hanging curl"])
def test_cosserat_rod_converges_to_the_heavy_rod(case: Case) -> None:
    tips, worst = zip(*(rod_errors(case, vertices) for vertices in (12, 24, 47)))
    assert worst[1] < 1.3
    orders = [math.log2(coarse / fine) for coarse, fine in pairwise(tips)]
    assert all(1.2 < order < 2.8 for order in orders)
    assert math.log2(worst[0] / worst[2]) / 2 > 1.4
    assert max(worst[2], tips[2]) < 0.35


def test_helix_stretches_by_twisting_and_bending_as_theory_says() -> None:
    for vertices, tolerance in ((24, 0.02), (47, 0.003)):
        measured, theory = helix_compliance(vertices)
        assert measured == pytest.approx(theory, rel=tolerance)


@pytest.mark.parametrize("case", [STRAIGHT, CURLY, Case(0.4, 60.0)], ids=["straight", "curly", "raised"])
def test_modified_energy_settles_into_its_closed_form(case: Case) -> None:
    assert closed_form_difference_mm(case, 24, HairMaterial()) < 1e-4


def test_modified_energy_is_no_rod() -> None:
    """One k cannot serve a strand held out and a curl that hangs: the page quotes by how much."""
    fits = [best_k_cosserat([case], 24, [case.true_shape(24)]) for case in (STRAIGHT, HANGING_CURL)]
    assert fits[0] == pytest.approx(1.5e-8, rel=0.1)
    assert fits[1] > 20 * fits[0]
    assert modified_error_mm(STRAIGHT, fits[0], 24, STRAIGHT.true_shape(24)) == pytest.approx(22, abs=2)


def test_full_rod_is_nearer_to_the_truth_than_the_other_models() -> None:
    truth = CURLY.true_shape(24)
    rod = rms_mm(settle_rod(CURLY.strand(24)).positions, truth)
    springs = rms_mm(settle_under_weight(mass_spring(), CURLY.strand(24), reach=3).positions, truth)
    modified = rms_mm(settle_under_weight(modified_cosserat(), CURLY.strand(24)).positions, truth)
    assert rod < 1.0
    assert springs > 10 * rod
    assert modified > 10 * rod


@pytest.mark.parametrize("k_body_collision", [1.0, 10.0])
def test_strand_on_the_floor_sinks_into_the_margin_until_contact_carries_it(k_body_collision: float) -> None:
    material = HairMaterial(k_body_collision=k_body_collision)
    expected = resting_depth(k_body_collision, REAL_HAIR_WEIGHT * 0.25 / 23)
    strand = STRAIGHT.strand(24)
    strand[:, 2] += material.collision_margin - expected
    depth = depths_in_margin(strand, above_plane, material)
    # The tip carries half an edge only and lies higher; what it lifts fades within a few edges.
    torch.testing.assert_close(depth[:12], torch.full_like(depth[:12], expected), rtol=1e-3, atol=0)
    assert depth[-1] < 0.85 * expected


def test_strand_over_a_ball_stays_outside_its_skin() -> None:
    material = HairMaterial()
    strand = STRAIGHT.strand(24)
    strand[:, 2] += material.collision_margin
    depth = depths_in_margin(strand, Sphere((0.0, 0.0, -0.1), 0.1), material)
    assert (depth > 0).sum() >= 5
    assert depth.max() < 0.2 * material.collision_margin


@pytest.mark.parametrize("length", [0.1, 0.4])
def test_stretch_under_own_weight_is_small_and_as_predicted(length: float) -> None:
    material = HairMaterial()
    worst, whole = stretch_percent(length, 24, material)
    edge = length / 23
    hanging = REAL_HAIR_WEIGHT * (length - 0.5 * edge)
    assert worst == pytest.approx(100 * hanging / (material.k_stretch * edge + material.k_cosserat / edge), rel=1e-9)
    assert whole < worst < 0.2


@pytest.mark.slow
def test_an_independent_engine_settles_on_the_heavy_rod() -> None:
    """PyElastica swings a rod of 10 cm to rest.

    It works in centimetres and milligrams: in SI units a hair's forces drown in its safeguards and it stays straight.
    Its clamp holds the whole first element, so its rod is half an element shorter. The section is thicker and softer
    than a hair's, of the same EI and weight, which allows longer steps.
    """
    elastica = pytest.importorskip("elastica", reason="PyElastica is not installed (pip install pyelastica)")

    class Simulator(
        elastica.BaseSystemCollection,  # type: ignore[name-defined]
        elastica.Constraints,  # type: ignore[name-defined]
        elastica.Forcing,  # type: ignore[name-defined]
        elastica.Damping,  # type: ignore[name-defined]
    ):
        pass

    elements, length, radius, step = 23, 10.0, 0.1, 1.5e-5
    area, moment_of_area = math.pi * radius**2, math.pi * radius**4 / 4
    stiffness = 8e3 / moment_of_area  # EI = 8e-9 N m^2 = 8e3 mg cm^3/s^2
    density = 64.0 / 981.0 / area  # 6.4e-5 N/m = 64 mg/s^2
    rod = elastica.CosseratRod.straight_rod(
        elements,
        np.zeros(3),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 0.0, 1.0]),
        length,
        radius,
        density=density,
        youngs_modulus=stiffness,
        shear_modulus=stiffness / (2 * 1.35),
    )
    simulator = Simulator()
    simulator.append(rod)
    clamp = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
    simulator.constrain(rod).using(elastica.OneEndFixedBC, **clamp)
    simulator.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -981.0]))
    simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, damping_constant=25.0, time_step=step)
    simulator.finalize()
    elastica.integrate(elastica.PositionVerlet(), simulator, 0.7, round(0.7 / step), progress_bar=False)
    half = 0.5 * 0.01 * length / elements
    beyond = np.arange(1, elements + 1) * 2 * half - half
    expected = HeavyRod(0.01 * length - half).shape(beyond) + np.array([half, 0.0, 0.0])
    settled = 0.01 * rod.position_collection.T[1:]
    assert np.linalg.norm(settled - expected, axis=1).max() < 1.5e-4
