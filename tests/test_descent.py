"""Adam and L-BFGS on directions and positions, their common measure, and every elastic model."""

from dataclasses import replace

import pytest
import torch

from benchmarks.rods.closed_form import equilibrium_edges
from quaffure import HairMaterial, InputError
from quaffure.backend import Backend
from quaffure.config import STANDARD_GRAVITY
from quaffure.draper import Draper
from quaffure.energies import ELASTIC_MODELS, Cosserat, HairEnergy, HairState, equilibrium_vectors, hair_terms
from quaffure.geometry import integrate_directions
from quaffure.solvers import (
    SOLVERS,
    AdamDraper,
    AdamPositionsDraper,
    DescentDraper,
    LbfgsDraper,
    LbfgsPositionsDraper,
    energy_and_gradient,
    solver,
)
from quaffure.solvers.descent import Directions
from quaffure.solvers.stopping import relative_gradient, without_tensions
from tests.scenes import bent_inwards, posed_scene, sphere_groom
from tests.test_xpbd import strands_by_hand

SOFT = HairMaterial(k_cosserat=5e-8)
"""Strands of 10 cm sag a good deal."""
FREE = replace(SOFT, k_body_collision=0.0, k_self_collision=0.0)
CROWDED = HairMaterial(k_self_collision=1e-4)


def horizontal_strand(length: float = 0.25) -> torch.Tensor:
    """A straight strand [1 24 3] along x."""
    strand = torch.zeros(1, 24, 3)
    strand[0, :, 0] = torch.linspace(0, length, 24)
    return strand


# --- the solvers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("draper", "share"),
    [
        pytest.param(AdamPositionsDraper(FREE, steps=500), 0.03, marks=pytest.mark.slow),
        (LbfgsPositionsDraper(FREE, 800), 0.6),
    ],
    ids=["adam_positions", "lbfgs_positions"],
)
def test_free_strands_descend_towards_the_closed_form(
    draper: AdamPositionsDraper | LbfgsPositionsDraper, share: float
) -> None:
    """At least a `share` of the energy between the posed groom and the exact minimum goes, and never more than all."""
    scene = posed_scene(sphere_groom(strands=12))
    energy = HairEnergy(scene.groom, FREE)
    rest = energy.rest
    edges = equilibrium_edges(scene.director, rest.rest_length, rest.mass_beyond, FREE.k_cosserat, FREE.k_stretch)
    exact = torch.cat([scene.posed[:, :, :1], scene.posed[:, :, :1] + edges.cumsum(2)], dim=2)
    least, most = (float(energy.total(x, scene)) for x in (exact, scene.posed))
    draped, report = draper.solve(scene)
    assert least < most
    assert share < (most - report.energy) / (most - least) < 1.001
    assert torch.equal(draped[:, :, 0], scene.posed[:, :, 0])


@pytest.mark.parametrize("acceleration", [(0.0, 0.0, 0.0), (3.0, 0.0, -9.0)])
def test_descent_starts_from_the_equilibrium_under_the_acceleration_of_the_energy(
    acceleration: tuple[float, float, float],
) -> None:
    scene = posed_scene(sphere_groom(strands=12))
    energy = HairEnergy(scene.groom, SOFT, hair_terms(acceleration=acceleration))
    pull = energy.rest.rest_length * energy.rest.mass_beyond / SOFT.k_cosserat
    expected = scene.director + pull[..., None] * torch.tensor(acceleration)
    expected = torch.nn.functional.normalize(expected, dim=-1)
    torch.testing.assert_close(Directions(energy, scene).values.detach(), expected)


def test_lbfgs_on_directions_pushes_the_sag_out_of_the_body_and_keeps_lengths() -> None:
    material = replace(SOFT, k_self_collision=0.0)
    scene = posed_scene(sphere_groom(strands=12))
    energy = HairEnergy(scene.groom, material)
    rest = energy.rest
    sag = equilibrium_vectors(scene.director, rest.rest_length, rest.mass_beyond, material.k_cosserat)
    start = integrate_directions(scene.posed[:, :, 0], sag, rest.rest_length)
    before = float(energy.per_vertex(energy.total(start, scene)))
    draped, report = LbfgsDraper(material).solve(scene)
    after = float(energy.per_vertex(torch.tensor([report.energy])))
    assert after < before - 0.1
    assert torch.allclose(draped.diff(dim=2).norm(dim=-1), rest.rest_length.expand(1, -1, -1), rtol=1e-4)
    assert torch.equal(draped[:, :, 0], scene.posed[:, :, 0])


@pytest.mark.parametrize("draper", [AdamDraper(CROWDED, steps=150), LbfgsDraper(CROWDED)], ids=["adam", "lbfgs"])
def test_strands_pressed_together_part_until_forces_balance(draper: DescentDraper) -> None:
    drop = torch.linspace(0, 0.05, 8)[:, None] * torch.tensor([0.0, 0.0, -1.0])
    rest = torch.stack([drop + torch.tensor([side, 0.0, 0.5]) for side in (-0.005, 0.005)])
    scene = posed_scene(strands_by_hand(rest), (rest * torch.tensor([0.2, 1.0, 1.0]))[None])
    reference = HairEnergy(scene.groom, CROWDED, backend=Backend.TORCH)
    draped = draper.drape(scene)
    before, after = (
        relative_gradient(reference, x, energy_and_gradient(reference, scene, x)[1]) for x in (scene.posed, draped)
    )
    assert float(draped[0, 1, -1, 0] - draped[0, 0, -1, 0]) > 0.006
    assert float(before) > 100
    assert float(after) < 0.05


@pytest.mark.parametrize("kind", [AdamDraper, AdamPositionsDraper])
def test_a_solver_starts_from_the_drape_that_it_is_given(kind: type[AdamDraper]) -> None:
    scene = posed_scene(sphere_groom(strands=8))
    rest_length = scene.groom.rest_lengths
    directions = torch.nn.functional.normalize(scene.director + torch.tensor([0.0, 0.0, -1.0]), dim=-1)
    start = integrate_directions(scene.posed[:, :, 0], directions, rest_length)
    torch.testing.assert_close(kind(steps=0).drape_from(scene, start), start, atol=1e-5, rtol=0)


def test_every_name_makes_a_draper_that_knows_its_name() -> None:
    for name in SOLVERS:
        draper = solver(name, FREE)
        assert isinstance(draper, Draper)
        assert draper.material == FREE
        assert draper.name == name
    for name in ("adam", "lbfgs_positions"):
        for elastic in ELASTIC_MODELS:
            assert solver(name, FREE, hair_terms(elastic)).terms == hair_terms(elastic)  # type: ignore[attr-defined]


def test_unknown_names_and_terms_that_a_solver_does_not_take_are_refused() -> None:
    with pytest.raises(InputError, match=r"one of strand_newton, .*magic"):
        solver("magic")
    with pytest.raises(InputError, match=r"one of modified_cosserat, .*jelly"):
        hair_terms("jelly")
    for name in ("xpbd", "xpbd_paper", "strand_newton"):
        with pytest.raises(InputError, match=rf"solver {name}: .*adam"):
            solver(name, terms=hair_terms("mass_spring"))
    with pytest.raises(InputError, match=r"solver xpbd_paper: .*modified_cosserat"):
        solver("xpbd_paper", terms=hair_terms("rod"))


# --- where solvers stop ----------------------------------------------------------------------------------------------


def test_tensions_along_the_edges_are_taken_out_of_a_gradient_and_nothing_else() -> None:
    groom = sphere_groom(strands=3, vertices=7)
    positions, _ = bent_inwards(groom)
    generator = torch.Generator().manual_seed(0)
    tangent = torch.nn.functional.normalize(positions.diff(dim=2), dim=-1)
    balanced = torch.zeros_like(positions)
    pull = torch.randn(tangent.shape[:3], generator=generator)[..., None] * tangent
    balanced[:, :, 1:] += pull
    balanced[:, :, :-1] -= pull
    assert without_tensions(positions, balanced).abs().max() < 1e-5 * balanced.norm()
    gradient = torch.randn(positions.shape, generator=generator)
    left = without_tensions(positions, gradient)
    assert (left.diff(dim=2) * tangent).sum(-1).abs().max() < 1e-5  # what is left lengthens no edge
    assert left[:, :, 0].abs().max() == 0
    torch.testing.assert_close(without_tensions(positions, gradient + 3 * balanced), left, atol=1e-4, rtol=1e-4)
    assert 0.3 * gradient.norm() < left.norm() < gradient.norm()


@pytest.mark.slow
def test_solvers_on_directions_and_on_positions_end_at_the_same_measure() -> None:
    scene = posed_scene(sphere_groom(strands=12, vertices=8))
    energy = HairEnergy(scene.groom, FREE)
    posed = relative_gradient(energy, scene.posed, energy_and_gradient(energy, scene, scene.posed)[1])
    weights = STANDARD_GRAVITY * energy.rest.mass[:, 1:].norm()
    untouched = energy_and_gradient(energy, scene, scene.posed)[1]
    assert float(untouched.norm() / weights) == pytest.approx(1, abs=0.2)
    assert 0.3 < float(posed) < 1
    on_directions = AdamDraper(FREE).solve(scene)[1]
    on_positions = LbfgsPositionsDraper(FREE, 600).solve(scene)[1]
    assert on_directions.relative_gradient < 1e-3
    assert on_directions.relative_gradient < on_positions.relative_gradient < float(posed)


# --- elastic models --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("elastic", "tip"),
    # docs/validation.md, straight, 25 cm; here with edges that keep their lengths.
    [
        ("modified_cosserat", (226.0, 0, -93.5)),
        pytest.param("cosserat", (34.2, 0, -237.2), marks=pytest.mark.slow),
        pytest.param("mass_spring", (27.1, 0, -239.7), marks=pytest.mark.slow),
    ],
)
def test_a_strand_hangs_as_its_elastic_model_is_documented_to(elastic: str, tip: tuple[float, float, float]) -> None:
    scene = posed_scene(strands_by_hand(horizontal_strand() + torch.tensor([0.1, 0.0, 0.5])))
    free = replace(HairMaterial(), k_body_collision=0.0, k_self_collision=0.0)
    draped, report = AdamDraper(free, terms=hair_terms(elastic)).solve(scene)
    distance = (1000 * (draped[0, 0, -1] - draped[0, 0, 0]) - torch.tensor(tip)).norm()
    assert distance < 2
    assert report.relative_gradient < 0.02


@pytest.mark.parametrize("elastic", list(ELASTIC_MODELS))
def test_gradient_of_the_whole_energy_is_that_of_finite_differences(elastic: str) -> None:
    groom = sphere_groom(strands=3, vertices=7)
    groom = replace(groom, rest_strands=groom.rest_strands.double())
    energy = HairEnergy(groom, HairMaterial(k_self_collision=1e-4), hair_terms(elastic))
    scene = posed_scene(groom)
    # Not as deep as they start: Eq. 10's cubic would drown the elastic part.
    bent = bent_inwards(groom, batch=1)[0].double()
    bent = groom.rest_strands + 0.2 * (bent - groom.rest_strands)
    variables = energy.initial_variables(scene)
    assert list(variables) == (["elastic"] if elastic == "cosserat" else [])
    free = bent[:, :, 1:].clone().requires_grad_()
    disturbed = [(value + 0.05 * torch.randn_like(value)).requires_grad_() for value in variables.values()]

    def total(free: torch.Tensor, *values: torch.Tensor) -> torch.Tensor:
        positions = torch.cat([bent[:, :, :1], free], dim=2)
        return 1e6 * energy.total(positions, scene, dict(zip(variables, values)))

    (gradient,) = torch.autograd.grad(total(free, *disturbed).sum(), free)
    assert gradient.abs().min() > 0
    assert torch.autograd.gradcheck(total, (free, *disturbed), eps=1e-7, atol=1e-3, rtol=1e-4)


def test_compiled_and_reference_energy_agree_for_every_elastic_model() -> None:
    groom = sphere_groom(strands=6)
    positions, scene = bent_inwards(groom, batch=1)[0], posed_scene(groom)
    for elastic in ELASTIC_MODELS:
        energy, twin = (HairEnergy(groom, None, hair_terms(elastic), backend) for backend in Backend)
        compiled, reference = energy.by_term(positions, scene), twin.by_term(positions, scene)
        assert compiled.keys() >= {"gravity", "body_collision", "self_collision"}
        assert ("elastic" in compiled) == (elastic != "modified_cosserat")
        total = energy.total(positions, scene)
        torch.testing.assert_close(total, torch.stack(list(reference.values())).sum(0), rtol=1e-4, atol=0)
        torch.testing.assert_close(total, torch.stack(list(compiled.values())).sum(0), rtol=1e-4, atol=0)


def test_frames_follow_their_edges_unless_variables_rotate_them() -> None:
    groom = sphere_groom(strands=5)
    positions, scene = bent_inwards(groom, batch=1)[0], posed_scene(groom)
    rod = Cosserat()
    energy = HairEnergy(groom, terms=(rod,))
    start = energy.initial_variables(scene)
    torch.testing.assert_close(energy.total(positions, scene), energy.total(positions, scene, start))
    rotated = {name: value + 0.1 for name, value in start.items()}
    assert (energy.total(scene.posed, scene, rotated) > 100 * energy.total(scene.posed, scene)).all()
    prepared = {rod.name: rod.prepare(energy.rest, scene)}
    hair = HairState(positions, energy.rest, energy.material, prepared=prepared)
    w, x, y, z = rod.frames(hair).unbind(-1)
    third = torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], dim=-1)
    torch.testing.assert_close(third, torch.nn.functional.normalize(positions.diff(dim=2), dim=-1), atol=1e-4, rtol=0)
