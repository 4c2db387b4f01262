"""The reference solver against its oracle, against the other solvers, and its derivatives against differences."""

from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from quaffure.config import HairMaterial
from quaffure.drapers.adam import AdamDraper
from quaffure.drapers.lbfgs import LbfgsDraper
from quaffure.drapers.newton import FEW, LEFT_OUT, NewtonDraper, heaviest
from quaffure.drapers.newton_descent import conjugate_gradients
from quaffure.drapers.newton_system import NewtonSystem, QuadraticModel
from quaffure.drapers.scene import Scene
from quaffure.drapers.xpbd import XpbdDraper
from quaffure.energies.block_tridiagonal import factor_strand, solve_strand
from quaffure.energies.closed_form import sagged_edges
from quaffure.energies.density_hessian import (
    Crowd,
    Pressed,
    crowd_of,
    density,
    density_blocks,
    density_force,
    density_product,
    pressed,
)
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.rounded_contact import CREASE_WIDTH, body_arrays, rounded_distance
from quaffure.energies.strand_hessian import hair_arrays, strand_hessian
from quaffure.energies.strand_newton import turn_edges
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.surface import Surface, posed_surface, surface_topology
from quaffure.types import Positions
from tests.scenes import bent_inwards, sphere_groom, sphere_surface
from tests.test_xpbd import scene_of

SOFT = HairMaterial(k_cosserat=5e-8)
"""Strands of 10 cm sag a good deal."""
FREE = replace(SOFT, k_body_collision=0.0, k_self_collision=0.0)
CROWDED = replace(SOFT, k_self_collision=1e-5, smoothing_length=0.02)


def in_double(energy: HairEnergy) -> HairEnergy:
    """The same energy with rest quantities in float64, for its torch twin."""
    named = {field.name: getattr(energy.rest, field.name) for field in fields(energy.rest)}
    doubled: dict[str, Any] = {name: value.double() for name, value in named.items() if torch.is_tensor(value)}
    energy.rest = replace(energy.rest, **doubled)
    return energy


def near_the_sphere(scene: Scene) -> np.ndarray:
    """Vertices within and beyond the margin of a sphere of radius 0.1 m, away from every rest length."""
    generator = torch.Generator().manual_seed(5)
    outward = torch.nn.functional.normalize(bent_inwards(scene.groom, 1)[0][0], dim=-1)
    return (outward * (0.0985 + 0.006 * torch.rand(*outward.shape[:2], 1, generator=generator))).double().numpy()


def test_free_strands_reach_the_closed_form_from_the_posed_groom() -> None:
    scene = scene_of(sphere_groom(strands=12))
    energy = HairEnergy(scene.groom, FREE)
    rest = energy.rest
    system = NewtonSystem(energy, scene, 0)
    settled, relative = NewtonDraper(FREE, tolerance=1e-6).minimize(system, scene.posed[0].double().numpy())
    exact = sagged_edges(
        scene.director.double(), rest.rest_length.double(), rest.mass_beyond.double(), FREE.k_cosserat, FREE.k_stretch
    )
    edges = torch.from_numpy(np.diff(settled, axis=1))[None]
    assert relative <= 1e-6
    assert (edges - scene.director * rest.rest_length[..., None]).norm() > 0.1 * exact.norm()
    assert (edges - exact).norm() < 1e-5 * exact.norm()


@pytest.mark.parametrize("material", [SOFT, CROWDED])
def test_no_solver_ends_below_newton(material: HairMaterial) -> None:
    scene = scene_of(sphere_groom(strands=40))
    energy = HairEnergy(scene.groom, material)
    draped, report = NewtonDraper(material).solve(scene)
    best = float(energy.per_vertex(energy.total(draped, scene.director, scene.surface)))
    for other in (AdamDraper(material, steps=300), LbfgsDraper(material), XpbdDraper(material)):
        reached = float(energy.per_vertex(torch.tensor(other.solve(scene)[1].energy)))
        assert best <= reached + 1e-6, other.name
    assert report.energy == pytest.approx(float(energy.total(draped, scene.director, scene.surface)))
    assert torch.equal(draped[:, :, 0], scene.posed[:, :, 0])


def test_contact_alone_settles_to_the_tolerance() -> None:
    material = replace(SOFT, k_self_collision=0.0)
    scene = scene_of(sphere_groom(strands=40))
    draped, report = NewtonDraper(material).solve(scene)
    assert report.relative_gradient <= 1e-4
    distance = signed_distance(draped[:, :, 1:].flatten(1, 2), scene.surface)
    assert (distance < material.collision_margin).float().mean() > 0.05
    assert (distance < 0).sum() == 0


def test_pressed_hair_comes_to_full_rest() -> None:
    scene = scene_of(sphere_groom(strands=40))
    system = NewtonSystem(HairEnergy(scene.groom, CROWDED), scene, 0)
    start = XpbdDraper(CROWDED).drape(scene)[0].double().numpy()
    settled, relative = NewtonDraper(CROWDED, tolerance=1e-6, steps=15).minimize(system, start)
    assert relative <= 1e-6
    reached = system.point(settled)
    assert (reached.excess > 0).mean() > 0.5
    assert np.linalg.norm(settled - start, axis=2).max() > 1e-4


def test_strands_alone_reach_the_minimum_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(sphere_groom(strands=120))
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
    assert sum(count <= FEW * 120 for count in moved) > 3
    assert 0 < np.linalg.norm(settled - lifted, axis=2).max() < 0.02
    assert settled == pytest.approx(at_rest, abs=2e-6)
    assert system.point(settled).energy == pytest.approx(system.point(at_rest).energy, rel=1e-9)


def test_a_part_is_the_whole_with_the_rest_held() -> None:
    scene = scene_of(sphere_groom(strands=30))
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
    assert np.abs(own.excess_beside).max() > 0
    slack = np.full(point.excess.shape, 0.01)
    model, models = QuadraticModel(system, whole, 0 * slack, 0.5), QuadraticModel(part, own, 0 * slack[strands], 0.5)
    scale = np.abs(model.gradient).max()
    assert models.gradient == pytest.approx(model.gradient[strands], rel=1e-5, abs=1e-6 * scale)
    product = model.product(step)[strands]
    assert models.product(step[strands]) == pytest.approx(product, abs=1e-5 * np.abs(product).max())
    change, changes = model.forecast(step), models.forecast(step[strands])
    assert changes.crowd_slope == pytest.approx(change.crowd_slope[strands], rel=1e-4)
    total = system.strand_gradient(whole) + system.crowd_gradient(whole)
    assert total == pytest.approx(model.gradient, rel=1e-5, abs=1e-6 * scale)


def test_the_heaviest_strands_leave_little_to_the_others() -> None:
    forces = np.random.default_rng(0).random(200) ** 8
    some = heaviest(forces)
    rest = np.delete(forces, some)
    assert 20 < len(some) < 100
    assert np.linalg.norm(rest) <= LEFT_OUT * np.linalg.norm(forces)
    assert rest.max() <= forces[some].min()
    assert np.linalg.norm(np.append(rest, forces[some].min())) > LEFT_OUT * np.linalg.norm(forces)


def test_negative_curvature_is_followed_downhill() -> None:
    scene = scene_of(sphere_groom(strands=20))
    system = NewtonSystem(HairEnergy(scene.groom, SOFT), scene, 0)
    start = bent_inwards(scene.groom, 1)[0][0].double().numpy()
    start[:, 0] = scene.posed[0, :, 0].numpy()
    for exactness, expected in ((1.0, True), (0.0, False)):
        model = QuadraticModel(system, system.point(start), np.zeros(start.shape[:2]), exactness)
        step, is_bent = conjugate_gradients(model, 0.1)
        assert is_bent == expected
        assert (model.gradient * step).sum() < 0


def test_energy_never_rises(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(sphere_groom(strands=40))
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
    scene = scene_of(sphere_groom(strands=20))
    energy = HairEnergy(scene.groom, CROWDED)
    positions = near_the_sphere(scene)
    system = NewtonSystem(energy, scene, 0)
    model = QuadraticModel(system, system.point(positions), np.zeros(positions.shape[:2]), 0.0)
    total, gradient = model.point.energy, model.gradient
    x = torch.from_numpy(positions)[None].requires_grad_()
    terms = in_double(energy).reference_terms(x, scene.director.double(), scene.surface)
    assert all(float(term.detach().abs()) > 0 for term in terms.values())
    (twin,) = torch.autograd.grad(sum(terms.values()).sum(), x)  # type: ignore[union-attr]
    twin[:, :, 0] = 0
    # Rounding moves the sphere's facets by a hundredth of the margin at their edges, and by nothing in their middle.
    differs = np.linalg.norm(gradient - twin[0].numpy(), axis=2) > 1e-9 * np.linalg.norm(gradient)
    assert differs[:, 1:].mean() < 0.2
    assert np.linalg.norm(gradient - twin[0].numpy()) < 0.02 * np.linalg.norm(gradient)
    assert total == pytest.approx(sum(float(term.detach()) for term in terms.values()), rel=0.01)
    step = 1e-8 * np.random.default_rng(1).normal(size=positions.shape)
    step[:, 0] = 0
    difference = system.point(positions + step).energy - system.point(positions - step).energy
    assert difference == pytest.approx(2 * float((gradient * step).sum()), rel=1e-5)


def dense(diagonal: np.ndarray, coupling: np.ndarray) -> np.ndarray:
    count = len(diagonal)
    matrix = np.zeros((count, 3, count, 3))
    for vertex in range(count):
        matrix[vertex, :, vertex] = diagonal[vertex]
        if 0 < vertex < count - 1:
            matrix[vertex, :, vertex + 1] = matrix[vertex + 1, :, vertex] = coupling[vertex]
    return matrix[1:, :, 1:].reshape(3 * count - 3, -1)


@pytest.mark.parametrize("surface", ["sphere", "crease"])
def test_strand_hessian_matches_differences_of_the_gradient(surface: str) -> None:
    scene = scene_of(sphere_groom(strands=12), surface=crease() if surface == "crease" else None)
    hair = hair_arrays(HairEnergy(scene.groom, HairMaterial()), scene.director[0])
    body = body_arrays(scene.surface, 0)
    positions = near_the_sphere(scene) if surface == "sphere" else near_the_crease(scene)
    count = positions.shape[1]
    bent = 0.0
    for strand, x in enumerate(positions):
        places = np.zeros(count, np.int64)

        def derivatives(at: np.ndarray, strand: int = strand, places: np.ndarray = places) -> tuple[np.ndarray, ...]:
            gradient, diagonal = np.empty((count, 3)), np.empty((count, 3, 3))
            coupling = np.empty((count - 1, 3, 3))
            strand_hessian(at, strand, hair, body, places, 1.0, gradient, diagonal, coupling)
            return gradient, diagonal, coupling

        matrix = dense(*derivatives(x)[1:])
        direction = np.random.default_rng(strand).normal(size=x.shape)
        direction[0] = 0
        difference = (derivatives(x + 1e-9 * direction)[0] - derivatives(x - 1e-9 * direction)[0]) / 2e-9
        product = matrix @ direction[1:].ravel()
        assert np.linalg.norm(difference[1:].ravel() - product) < 1e-4 * np.linalg.norm(product)
        bent = max(bent, float(np.abs(matrix - matrix.T).max()))
    assert bent < 1e-9


def crease() -> Surface:
    """A closed body with a hollow edge along y at the origin: a block with a roof turned upside down cut into it."""
    profile = [(-0.2, 0.1), (-0.2, -0.3), (0.2, -0.3), (0.2, 0.1), (0.0, 0.0)]
    vertices = torch.tensor([(x, y, z) for y in (-0.2, 0.2) for x, z in profile])
    sides = [(i, (i + 1) % 5) for i in range(5)]
    faces = [triangle for i, j in sides for triangle in ((i, j, j + 5), (i, j + 5, i + 5))]
    caps = [(0, 4, 1), (1, 4, 2), (2, 4, 3)]
    faces += caps + [(a + 5, c + 5, b + 5) for a, b, c in caps]
    return outward(vertices, torch.tensor(faces))


def outward(vertices: torch.Tensor, faces: torch.Tensor) -> Surface:
    corners = vertices[faces].double()
    volume = (corners[:, 0] * torch.linalg.cross(corners[:, 1], corners[:, 2])).sum()
    return posed_surface(surface_topology(vertices, faces if volume > 0 else faces.flip(1)), vertices[None])


def near_the_crease(scene: Scene) -> np.ndarray:
    """Vertices 2.5 mm off both faces of the hollow, within a few widths of where both are equally near."""
    generator = np.random.default_rng(7)
    strands, vertices = scene.groom.rest_strands.shape[:2]
    x = CREASE_WIDTH * generator.normal(size=(strands, vertices))
    y = 0.01 * np.arange(vertices) - 0.1 + 0.002 * generator.normal(size=(strands, vertices))
    return np.stack([x, y, np.full_like(x, 2.5e-3 * np.sqrt(1.25))], axis=-1)


def test_rounded_distance_neither_jumps_nor_rises_faster_than_one_moves(surface: Surface) -> None:
    """Its gradient is a mean of unit vectors. Lines through the margin of the whole body cross creases and corners."""
    arrays, generator = body_arrays(surface, 0), np.random.default_rng(0)
    starts = surface.corners[0].mean(1) + 2.5e-3 * surface.normals[0, :, 0]
    normal, crease, bulge = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    crossed = 0.0
    for start in starts[generator.integers(len(starts), size=60)].astype(np.float64):
        towards = generator.normal(size=3)
        line = start + 2e-6 * np.arange(1000)[:, None] * (towards / np.linalg.norm(towards))
        found = [rounded_distance(point, 0, 5e-3, arrays, normal, crease, bulge)[0] for point in line]
        near = np.array([value for value in found if 1e-4 < value < 5e-3])
        if len(near) == len(line):
            assert np.abs(np.diff(near)).max() <= 2e-6 * 1.001
            crossed += float(np.abs(np.diff(near, 2)).max() > 1e-9)
    assert crossed > 10


def test_a_crease_is_rounded_from_below_and_nothing_else_is() -> None:
    body = body_arrays(crease(), 0)
    normal, hollow, bulge = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    off = 2.5e-3
    at = np.array([0.0, 0.01, off * np.sqrt(1.25)])
    distance, _ = rounded_distance(at, 0, 3e-3, body, normal, hollow, bulge)
    # The sides of the hollow are cut into two triangles each, so that at most four faces count.
    assert off - 2 * CREASE_WIDTH < distance <= off - CREASE_WIDTH * np.log(2) + 1e-9
    assert abs(normal[0]) < 1e-6
    assert hollow[0, 0] > 1e3
    beside = at + np.array([5e-3, 0.0, 2.5e-3])
    assert rounded_distance(beside, 0, 3e-3, body, normal, hollow, bulge)[0] == pytest.approx(off, abs=1e-8)
    assert np.abs(hollow).max() < 1e-6
    assert normal == pytest.approx(np.array([-1.0, 0.0, 2.0]) / np.sqrt(5), abs=1e-6)


def crowded_points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that all press on each other, their masses and rest densities."""
    generator = np.random.default_rng(2)
    points, mass = 0.02 * generator.random((60, 3)), 1e-7 * (1 + generator.random(60))
    return points, mass, 0.5 * density(crowd_of(points, mass, 5e-3))


def pairs_of(crowd: Crowd, rest: np.ndarray, exactness: float) -> tuple[Pressed, np.ndarray]:
    """The pairs of the sum of cubed excesses, and the cube's slope."""
    excess = (density(crowd) - rest).clip(min=0)
    return pressed(crowd, 3 * excess**2, 6 * excess, exactness), 3 * excess**2


def test_hessian_of_the_densities_matches_differences_of_their_gradient() -> None:
    points, mass, rest = crowded_points()
    crowd = crowd_of(points, mass, 5e-3)

    def gradient(x: np.ndarray) -> np.ndarray:
        # The same order as the undisturbed crowd's, though a point may have crossed into another cell.
        moved = crowd._replace(x=x[:, 0].copy(), y=x[:, 1].copy(), z=x[:, 2].copy())
        return density_force(*pairs_of(moved, rest, 1.0))

    sorted_points = points[crowd.order]
    step = np.random.default_rng(3).normal(size=points.shape)
    difference = (gradient(sorted_points + 1e-5 * step) - gradient(sorted_points - 1e-5 * step)) / 2e-5
    product = density_product(pairs_of(crowd, rest, 1.0)[0], step)
    # Single precision allows no smaller step.
    assert np.linalg.norm(difference - product) < 3e-3 * np.linalg.norm(product)


@pytest.mark.parametrize("exactness", [0.0, 0.5, 1.0])
def test_blocks_are_those_of_the_whole_hessian(exactness: float) -> None:
    points, mass, rest = crowded_points()
    pairs, _ = pairs_of(crowd_of(points, mass, 5e-3), rest, exactness)
    columns = [density_product(pairs, one.reshape(60, 3)).ravel() for one in np.eye(180)]
    whole = np.stack(columns, axis=1)
    own = np.stack([whole[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(60)])
    scale = np.abs(whole).max()
    assert density_blocks(pairs) == pytest.approx(own, rel=1e-4, abs=1e-5 * scale)
    assert np.abs(whole - whole.T).max() < 1e-5 * scale
    least = np.linalg.eigvalsh(0.5 * (whole + whole.T))[0]
    assert least < -1e-3 * scale if exactness == 1.0 else exactness > 0 or least > -1e-5 * scale


def test_edges_turn_without_stretching_and_follow_a_step_to_first_order() -> None:
    generator = np.random.default_rng(6)
    positions = np.cumsum(0.01 * generator.normal(size=(5, 8, 3)), axis=1)
    step = generator.normal(size=positions.shape)
    step[:, 0] = 0
    moved = np.empty_like(positions)
    turn_edges(positions, 1e-6 * step, moved)
    assert np.abs(moved - positions - 1e-6 * step).max() < 1e-3 * 1e-6 * np.abs(step).max()
    edges = np.diff(positions, axis=1)
    across = np.cross(edges, generator.normal(size=edges.shape))
    turn_edges(positions, np.pad(np.cumsum(30 * across, axis=1), ((0, 0), (1, 0), (0, 0))), moved)
    assert np.linalg.norm(np.diff(moved, axis=1) - edges, axis=2).max() > 1e-3
    assert np.linalg.norm(np.diff(moved, axis=1), axis=2) == pytest.approx(np.linalg.norm(edges, axis=2))


def test_factors_solve_a_strand_and_refuse_an_indefinite_one() -> None:
    generator = np.random.default_rng(4)
    coupling = generator.normal(size=(5, 3, 3))
    coupling += coupling.transpose(0, 2, 1)
    diagonal = np.tile(12 * np.eye(3), (6, 1, 1))
    inverse, right, solution = np.empty((6, 3, 3)), generator.normal(size=(6, 3)), np.empty((6, 3))
    assert factor_strand(diagonal, coupling, inverse)
    solve_strand(coupling, inverse, right, solution)
    assert dense(diagonal, coupling) @ solution[1:].ravel() == pytest.approx(right[1:].ravel(), abs=1e-9)
    assert not factor_strand(diagonal - 12 * np.eye(3), coupling, inverse)
    # The factors are those of a matrix near by that is definite.
    for force in generator.normal(size=(20, 6, 3)):
        solve_strand(coupling, inverse, force, solution)
        assert 0 < (force[1:] * solution[1:]).sum() < np.inf


def test_samples_of_a_batch_are_settled_one_by_one() -> None:
    groom = sphere_groom(strands=10)
    material = replace(SOFT, k_self_collision=0.0)
    posed: Positions = groom.rest_strands.expand(2, -1, -1, -1).clone()
    posed[1] = posed[1] @ torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    both = NewtonDraper(material).drape(scene_of(groom, posed, sphere_surface(2)))
    alone = NewtonDraper(material).drape(scene_of(groom, posed[1:], sphere_surface(1)))
    assert (both[0] - both[1]).norm() > 0.1
    assert torch.allclose(both[1:], alone, atol=1e-4)
