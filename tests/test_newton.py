"""The reference solver against its oracle, the other solvers and its starts; its energy against the torch twin."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.rods.closed_form import equilibrium_edges
from quaffure.baselines import PosedDraper
from quaffure.config import HairMaterial
from quaffure.energies import HairEnergy
from quaffure.geometry.signed_distance import signed_distance
from quaffure.solvers import AdamDraper, LbfgsDraper, XpbdDraper
from quaffure.solvers.newton.newton import ACTIVE_SHARE, HELD_SHARE, LBFGS_EVALUATIONS, PATIENT, NewtonDraper, heaviest
from quaffure.solvers.newton.newton_descent import MOST_DAMPING, TrustRegionState, conjugate_gradients
from quaffure.solvers.newton.newton_system import NewtonSystem, Point, QuadraticModel
from quaffure.types import Positions
from tests.scenes import bent_inwards, posed_scene, sphere_groom, sphere_surface
from tests.test_strand_newton import near_the_sphere

SOFT = HairMaterial(k_cosserat=5e-8)
"""Strands of 10 cm sag a good deal."""
FREE = replace(SOFT, k_body_collision=0.0, k_self_collision=0.0)
CROWDED = replace(SOFT, k_self_collision=1e-5, smoothing_length=0.02)


def test_free_strands_reach_the_closed_form_from_the_posed_groom() -> None:
    scene = posed_scene(sphere_groom(strands=12))
    energy = HairEnergy(scene.groom, FREE)
    rest = energy.rest
    system = NewtonSystem(energy, scene, 0)
    settled, relative = NewtonDraper(FREE, tolerance=1e-6).minimize(system, scene.posed[0].double().numpy())
    exact = equilibrium_edges(
        scene.director.double(), rest.rest_length.double(), rest.mass_beyond.double(), FREE.k_cosserat, FREE.k_stretch
    )
    edges = torch.from_numpy(np.diff(settled, axis=1))[None]
    assert relative <= 1e-6
    assert (edges - scene.director * rest.rest_length[..., None]).norm() > 0.1 * exact.norm()
    assert (edges - exact).norm() < 1e-5 * exact.norm()


@pytest.mark.parametrize("material", [SOFT, CROWDED])
def test_no_solver_ends_below_newton(material: HairMaterial) -> None:
    scene = posed_scene(sphere_groom(strands=40))
    energy = HairEnergy(scene.groom, material)
    draped, report = NewtonDraper(material).solve(scene)
    best = float(energy.per_vertex(energy.total(draped, scene)))
    for other in (AdamDraper(material, steps=300), LbfgsDraper(material), XpbdDraper(material)):
        reached = float(energy.per_vertex(torch.tensor([other.solve(scene)[1].energy])))
        assert best <= reached + 1e-6, other.name
    assert report.energy == pytest.approx(float(energy.total(draped, scene)))
    assert torch.equal(draped[:, :, 0], scene.posed[:, :, 0])


def test_contact_alone_settles_to_the_tolerance() -> None:
    material = replace(SOFT, k_self_collision=0.0)
    scene = posed_scene(sphere_groom(strands=40))
    system = NewtonSystem(HairEnergy(scene.groom, material), scene, 0)
    start = XpbdDraper(material).drape(scene)[0].double().numpy()
    settled, relative = NewtonDraper(material).minimize(system, start)
    assert relative <= 1e-4
    distance = signed_distance(torch.from_numpy(settled[None, :, 1:]).float().flatten(1, 2), scene.surface)
    assert (distance < material.collision_margin).float().mean() > 0.05
    assert (distance < 0).sum() == 0


def test_pressed_hair_comes_to_full_rest() -> None:
    scene = posed_scene(sphere_groom(strands=40))
    system = NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0)
    start = XpbdDraper(CROWDED).drape(scene)[0].double().numpy()
    settled, relative = NewtonDraper(CROWDED, tolerance=1e-6, steps=15).minimize(system, start)
    assert relative <= 1e-6
    reached = system.point(settled)
    assert (reached.excess > 0).mean() > 0.5
    assert np.linalg.norm(settled - start, axis=2).max() > 1e-4


def test_strands_alone_reach_the_minimum_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = posed_scene(sphere_groom(strands=120))
    system = NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0)
    draper = NewtonDraper(CROWDED, tolerance=1e-6)
    at_rest, relative = draper.minimize(system, XpbdDraper(CROWDED).drape(scene)[0].double().numpy())
    assert relative <= 1e-6
    lifted = at_rest.copy()
    lifted[7::40, 1:, 2] += 1e-3 * np.linspace(0, 1, lifted.shape[1] - 1)
    moved: list[int] = []
    make = QuadraticModel.__init__

    def watched(self: QuadraticModel, *arguments: Any) -> None:
        make(self, *arguments)
        moved.append(len(self.gradient))

    monkeypatch.setattr(QuadraticModel, "__init__", watched)
    settled, relative = draper.minimize(system, lifted)
    assert relative <= 1e-6
    assert sum(count <= ACTIVE_SHARE * 120 for count in moved) > 3
    assert 0 < np.linalg.norm(settled - lifted, axis=2).max() < 0.02
    assert settled == pytest.approx(at_rest, abs=2e-6)
    assert system.point(settled).energy == pytest.approx(system.point(at_rest).energy, rel=1e-9)


def test_a_part_is_the_whole_with_the_rest_held() -> None:
    scene = posed_scene(sphere_groom(strands=30))
    system = NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0)
    point = system.point(XpbdDraper(CROWDED).drape(scene)[0].double().numpy())
    strands = np.array([3, 4, 11, 29])
    part = system.of_strands(strands, point)
    step = np.zeros(point.positions.shape)
    step[strands] = 1e-4 * np.random.default_rng(0).normal(size=(4, *point.positions.shape[1:]))
    step[:, 0] = 0
    own = part.point((point.positions + step)[strands])
    whole = system.point(point.positions + step)
    assert own.energy == pytest.approx(whole.energy, rel=1e-12)
    joined = system.joined(point, strands, part, own)
    assert joined.energy == pytest.approx(whole.energy, rel=1e-12)
    assert joined.excess == pytest.approx(whole.excess, abs=1e-9)
    assert np.abs(own.fixed_excess).max() > 0
    slack = np.full(point.excess.shape, 0.01)
    model, models = QuadraticModel(system, whole, 0 * slack, 0.5), QuadraticModel(part, own, 0 * slack[strands], 0.5)
    scale = np.abs(model.gradient).max()
    assert models.gradient == pytest.approx(model.gradient[strands], rel=1e-5, abs=1e-6 * scale)
    product = model.product(step)[strands]
    assert models.product(step[strands]) == pytest.approx(product, abs=1e-5 * np.abs(product).max())
    change, changes = model.predicted(step), models.predicted(step[strands])
    assert changes.density_slope == pytest.approx(change.density_slope[strands], rel=1e-4)
    total = system.strand_gradient(whole) + system.density_energy_gradient(whole)
    assert total == pytest.approx(model.gradient, rel=1e-5, abs=1e-6 * scale)


def test_the_heaviest_strands_leave_little_to_the_others() -> None:
    forces = np.random.default_rng(0).random(200) ** 8
    some = heaviest(forces)
    rest = np.delete(forces, some)
    assert 20 < len(some) < 100
    assert np.linalg.norm(rest) <= HELD_SHARE * np.linalg.norm(forces)
    assert rest.max() <= forces[some].min()
    assert np.linalg.norm(np.append(rest, forces[some].min())) > HELD_SHARE * np.linalg.norm(forces)


def test_negative_curvature_is_followed_downhill() -> None:
    scene = posed_scene(sphere_groom(strands=20))
    system = NewtonSystem(HairEnergy(scene.groom, SOFT), scene, 0)
    start = bent_inwards(scene.groom, 1)[0][0].double().numpy()
    start[:, 0] = scene.posed[0, :, 0].numpy()
    for exactness, expected in ((1.0, True), (0.0, False)):
        model = QuadraticModel(system, system.point(start), np.zeros(start.shape[:2]), exactness)
        step, has_negative_curvature = conjugate_gradients(model, 0.1)
        assert has_negative_curvature == expected
        assert (model.gradient * step).sum() < 0


def test_energy_never_rises(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = posed_scene(sphere_groom(strands=40))
    reached: list[float] = []
    make = QuadraticModel.__init__

    def watched(self: QuadraticModel, *arguments: Any) -> None:
        make(self, *arguments)
        reached.append(self.point.energy)

    monkeypatch.setattr(QuadraticModel, "__init__", watched)
    start = bent_inwards(scene.groom, 1)[0][0].double().numpy()
    start[:, 0] = scene.posed[0, :, 0].numpy()
    NewtonDraper(CROWDED).minimize(NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0), start)
    assert len(reached) > 5
    assert reached[-1] < reached[0] - 0.5 * abs(reached[-1])
    # A part adds up fewer terms than the whole.
    assert all(after <= before + 1e-12 * abs(before) for before, after in pairwise(reached))


def test_gradient_is_that_of_the_torch_twin() -> None:
    groom = sphere_groom(strands=20)
    scene = posed_scene(replace(groom, rest_strands=groom.rest_strands.double()))
    energy = HairEnergy(scene.groom, CROWDED)
    positions = near_the_sphere(scene)
    system = NewtonSystem(energy, scene, 0)
    model = QuadraticModel(system, system.point(positions), np.zeros(positions.shape[:2]), 0.0)
    total, gradient = model.point.energy, model.gradient
    x = torch.from_numpy(positions)[None].requires_grad_()
    terms = energy.by_term(x.detach(), scene)
    assert all(float(term.abs()) > 0 for term in terms.values())
    (twin,) = torch.autograd.grad(energy.total(x, scene).sum(), x)
    twin[:, :, 0] = 0
    # Rounding moves the sphere's facets by a hundredth of the margin at their edges, and by nothing in their middle.
    differs = np.linalg.norm(gradient - twin[0].numpy(), axis=2) > 1e-9 * np.linalg.norm(gradient)
    assert differs[:, 1:].mean() < 0.2
    assert np.linalg.norm(gradient - twin[0].numpy()) < 0.02 * np.linalg.norm(gradient)
    assert total == pytest.approx(sum(float(term) for term in terms.values()), rel=0.01)
    step = 1e-8 * np.random.default_rng(1).normal(size=positions.shape)
    step[:, 0] = 0
    difference = system.point(positions + step).energy - system.point(positions - step).energy
    assert difference == pytest.approx(2 * float((gradient * step).sum()), rel=1e-5)


def test_a_sample_does_not_know_its_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """L-BFGS, whose batches are one problem, is the only start."""
    monkeypatch.setattr(
        "quaffure.solvers.newton.newton.XpbdDraper", lambda material, setting=None: PosedDraper(material)
    )
    groom = sphere_groom(strands=10)
    posed: Positions = groom.rest_strands.expand(2, -1, -1, -1).clone()
    posed[1] = posed[1] @ torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    draper = NewtonDraper(CROWDED, steps=1)
    both = draper.drape(posed_scene(groom, posed, sphere_surface(2)))
    alone = draper.drape(posed_scene(groom, posed[1:], sphere_surface(1)))
    assert (both[0] - both[1]).norm() > 0.1
    assert torch.equal(both[1:], alone)


def test_the_drape_of_many_strands_is_above_none_of_its_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = posed_scene(sphere_groom(strands=200))
    energy = HairEnergy(scene.groom, CROWDED)
    moved: list[int] = []
    make = QuadraticModel.__init__

    def watched(self: QuadraticModel, *arguments: Any) -> None:
        make(self, *arguments)
        moved.append(len(self.gradient))

    monkeypatch.setattr(QuadraticModel, "__init__", watched)
    draped, report = NewtonDraper(CROWDED, steps=25).solve(scene)

    def exact(positions: Positions) -> float:
        return float(energy.total(positions, scene))

    for start in newton_starts(CROWDED):
        assert exact(draped) <= exact(start.drape(scene)), start.name
    assert sum(count <= ACTIVE_SHARE * 200 for count in moved) > 3
    assert report.energy == pytest.approx(exact(draped), rel=1e-6)
    assert (NewtonSystem(energy, scene, 0).point(draped[0].double().numpy()).excess > 0).mean() > 0.3


def newton_starts(material: HairMaterial) -> list[XpbdDraper | LbfgsDraper]:
    lbfgs = LbfgsDraper(material, evaluations=LBFGS_EVALUATIONS)
    return [XpbdDraper(material), XpbdDraper(material, PATIENT), lbfgs]


def test_the_best_start_is_kept_where_newton_ends_above_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def lift(self: NewtonDraper, system: NewtonSystem, positions: np.ndarray) -> tuple[np.ndarray, float]:
        return positions + np.array([0.0, 0.0, 0.01]), 0.0

    monkeypatch.setattr(NewtonDraper, "minimize", lift)
    scene = posed_scene(sphere_groom(strands=10))
    draped, report = NewtonDraper(SOFT).solve(scene)
    drapes = [start.drape(scene) for start in newton_starts(SOFT)]
    costs = [float(HairEnergy(scene.groom, SOFT).total(x, scene)) for x in drapes]
    assert torch.equal(draped, drapes[int(np.argmin(costs))])
    assert report.energy == pytest.approx(min(costs))
    assert report.relative_gradient > 0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_positions_that_are_not_finite_raise(value: float) -> None:
    scene = posed_scene(sphere_groom(strands=10))
    system = NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0)
    broken = scene.posed[0].double().numpy()
    broken[3, 5, 1] = value
    with pytest.raises(ValueError, match="finite"):
        system.point(broken)
    scene.posed[0, 3, 5, 1] = value
    with pytest.raises(ValueError, match="finite"):
        NewtonDraper(CROWDED).solve(scene)


def test_a_part_hands_no_damping_to_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the first strands moved alone had been damped for ever: all together, they start without."""
    scene = posed_scene(sphere_groom(strands=120))
    system = NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0)
    told: list[tuple[int, float]] = []

    def stuck(
        part: NewtonSystem, point: Point, trust: TrustRegionState, target: float, steps: int
    ) -> tuple[Point, TrustRegionState, int]:
        told.append((len(point.positions), trust.damping))
        return point, replace(trust, damping=4 * max(trust.damping, MOST_DAMPING)), steps

    monkeypatch.setattr("quaffure.solvers.newton.newton.descend", stuck)
    monkeypatch.setattr("quaffure.solvers.newton.newton.heaviest", lambda forces: np.arange(20))
    NewtonDraper(CROWDED).minimize(system, scene.posed[0].double().numpy())
    assert told[:2] == [(20, 0.0), (120, 0.0)]
    assert told[2][1] > MOST_DAMPING
    assert len(told) == 3
