"""A strand's Hessian against differences, the body's rounded creases, edges that turn, block-tridiagonal factors."""

import numpy as np
import pytest
import torch

from quaffure.config import HairMaterial
from quaffure.energies import HairEnergy
from quaffure.geometry import Surface, posed_surface, surface_topology
from quaffure.scene import PosedScene
from quaffure.solvers.newton.block_tridiagonal import factor_strand, solve_strand
from quaffure.solvers.newton.rounded_contact import ROUNDING_WIDTH, body_arrays, rounded_distance
from quaffure.solvers.newton.strand_hessian import StrandSystem, hair_arrays, strand_hessian
from quaffure.solvers.newton.strand_newton import turn_edges
from tests.scenes import bent_inwards, posed_scene, sphere_groom


def near_the_sphere(scene: PosedScene) -> np.ndarray:
    """Vertices within and beyond the margin of a sphere of radius 0.1 m, away from every rest length."""
    generator = torch.Generator().manual_seed(5)
    outward = torch.nn.functional.normalize(bent_inwards(scene.groom, 1)[0][0], dim=-1)
    return (outward * (0.0985 + 0.006 * torch.rand(*outward.shape[:2], 1, generator=generator))).double().numpy()


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
    scene = posed_scene(sphere_groom(strands=12), surface=crease() if surface == "crease" else None)
    hair = hair_arrays(HairEnergy(scene.groom, HairMaterial()), scene.director[0])
    body = body_arrays(scene.surface, 0)
    positions = near_the_sphere(scene) if surface == "sphere" else near_the_crease(scene)
    count = positions.shape[1]
    bent = 0.0
    for strand, x in enumerate(positions):
        leaves = np.zeros(count, np.int64)

        def derivatives(at: np.ndarray, strand: int = strand, leaves: np.ndarray = leaves) -> tuple[np.ndarray, ...]:
            system = StrandSystem(np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count - 1, 3, 3)))
            strand_hessian(at, strand, hair, body, leaves, 1.0, system)
            return system

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


def near_the_crease(scene: PosedScene) -> np.ndarray:
    """Vertices 2.5 mm off both faces of the hollow, within a few widths of where both are equally near."""
    generator = np.random.default_rng(7)
    strands, vertices = scene.groom.rest_strands.shape[:2]
    x = ROUNDING_WIDTH * generator.normal(size=(strands, vertices))
    y = 0.01 * np.arange(vertices) - 0.1 + 0.002 * generator.normal(size=(strands, vertices))
    return np.stack([x, y, np.full_like(x, 2.5e-3 * np.sqrt(1.25))], axis=-1)


def test_rounded_distance_neither_jumps_nor_rises_faster_than_one_moves(surface: Surface) -> None:
    """Its gradient is a mean of unit vectors. Lines through the margin of the whole body cross creases and corners."""
    arrays, generator = body_arrays(surface, 0), np.random.default_rng(0)
    starts = surface.arrays.corners[0].mean(1) + 2.5e-3 * surface.arrays.normals[0, :, 0]
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
    assert off - 2 * ROUNDING_WIDTH < distance <= off - ROUNDING_WIDTH * np.log(2) + 1e-9
    assert abs(normal[0]) < 1e-6
    assert hollow[0, 0] > 1e3
    next_to_it = at + np.array([5e-3, 0.0, 2.5e-3])
    assert rounded_distance(next_to_it, 0, 3e-3, body, normal, hollow, bulge)[0] == pytest.approx(off, abs=1e-8)
    assert np.abs(hollow).max() < 1e-6
    assert normal == pytest.approx(np.array([-1.0, 0.0, 2.0]) / np.sqrt(5), abs=1e-6)


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


def test_an_edge_without_length_goes_where_the_step_says() -> None:
    positions = np.array([[[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0.01], [0, 0, 0.02]]])
    step = np.array([[[0.0, 0, 0], [0, 0, 0], [0.001, 0, 0], [0.001, 0, 0]]])
    moved = np.empty_like(positions)
    turn_edges(positions, step, moved)
    assert moved == pytest.approx(positions + step)
    turn_edges(positions, np.zeros_like(step), moved)
    assert moved == pytest.approx(positions)


def test_a_matrix_that_is_not_finite_moves_nothing() -> None:
    diagonal, inverse = np.full((3, 3, 3), np.nan), np.full((3, 3, 3), 7.0)
    assert not factor_strand(diagonal, np.zeros((2, 3, 3)), inverse)
    assert (inverse == 0).all()
