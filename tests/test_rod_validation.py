"""The elastic models against theory. `docs/validation.md` holds the same comparisons at more sizes."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from benchmarks.rods.elastic_potentials import mass_spring, modified_cosserat
from benchmarks.rods.elastica_rod import EDGES, LENGTH, SETTLED
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
from quaffure import HairMaterial

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


def test_an_independent_engine_settles_on_the_heavy_rod() -> None:
    """PyElastica swung a rod of 10 cm to rest. Its clamp holds the first edge, so that the rod begins half way."""
    half = 0.5 * LENGTH / EDGES
    beyond = np.arange(1, EDGES + 1) * 2 * half - half
    expected = HeavyRod(LENGTH - half).shape(beyond) + np.array([half, 0.0, 0.0])
    settled = 1e-5 * SETTLED.T
    assert np.abs(expected[:, 1]).max() < 1e-12
    assert np.linalg.norm(settled - expected[:, [0, 2]], axis=1).max() < 1.5e-4
    # The figure of half an edge matters: the tolerance tells the two rods apart.
    whole = HeavyRod(LENGTH).shape(beyond + half)
    assert np.linalg.norm(settled - whole[:, [0, 2]], axis=1).max() > 5e-4
