from collections.abc import Callable

import igl
import numpy as np
import pytest
import torch

from quaffure.body import load_body, load_pose_prior
from quaffure.geometry import (
    FREE,
    FREE_DISTANCE,
    OUTSIDE,
    Bvh,
    Surface,
    classify,
    occupancy_of,
    posed_surface,
    surface_topology,
)
from quaffure.geometry.bvh import nearest_face, search_all, search_workspace
from quaffure.geometry.mesh import opposite_faces
from quaffure.geometry.occupancy_grid import UNKNOWN
from quaffure.geometry.signed_distance import (
    closest_points,
    closest_points_by_leaves,
    closest_points_reference,
    signed_distance,
)
from quaffure.geometry.surface import bvh_of, reference_surface_normals
from quaffure.geometry.triangle import squared_distance
from quaffure.scene import BodyBatch
from quaffure.training import PoseSampler
from tests.scenes import sphere_mesh, sphere_surface, surface_on


def star() -> tuple[torch.Tensor, torch.Tensor]:
    """A closed surface with sharp ridges and deep valleys: every kind of nearest feature occurs."""
    vertices, faces = sphere_mesh(count=300)
    return vertices * (1 + 0.6 * torch.rand(300, 1, generator=torch.Generator().manual_seed(0))), faces


def queries(count: int = 4000) -> torch.Tensor:
    return 0.25 * (torch.rand(1, count, 3, generator=torch.Generator().manual_seed(1)) - 0.5)


def test_agrees_with_libigl_on_a_ragged_surface() -> None:
    vertices, faces = star()
    points = queries()
    found = signed_distance(points, posed_surface(surface_topology(vertices, faces), vertices[None]))[0]
    exact = igl.signed_distance(
        points[0].double().numpy(),
        vertices.double().numpy(),
        faces.numpy(),
        sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL,
    )[0]
    assert (exact < 0).mean() > 0.1
    np.testing.assert_allclose(found.numpy(), exact, atol=2e-6)


def test_kernel_and_twin_agree() -> None:
    vertices, faces = star()
    surface = posed_surface(
        surface_topology(vertices, faces), torch.stack([vertices, 1.3 * vertices.flip(1)[:, [0, 2, 1]]])
    )
    points = queries(500).expand(2, -1, -1)
    kernel, twin = closest_points(points, surface), closest_points_reference(points, surface)
    triangles = surface.vertices[:, faces]
    for sample in range(2):
        feet = [
            (found.barycentric[sample, :, :, None] * triangles[sample, found.faces[sample]]).sum(1)
            for found in (kernel, twin)
        ]
        torch.testing.assert_close(feet[0], feet[1], atol=2e-6, rtol=0)
    # Faces that share the nearest edge may both be named; the normal of the feature must be the same.
    alike = torch.nn.functional.cosine_similarity(kernel.normals, twin.normals, dim=-1) > 0.999
    assert alike.float().mean() > 0.995


def test_leaves_leave_out_no_face() -> None:
    """Near the surface and far from it, and where several faces are as near as each other."""
    vertices, faces = star()
    surface = posed_surface(surface_topology(vertices, faces), vertices[None])
    points = torch.cat([queries(300), 5 * queries(50), vertices[None, :30]], dim=1)
    found, twin = closest_points_by_leaves(points, surface), closest_points_reference(points, surface)
    for one, other in zip(vars(found).values(), vars(twin).values()):
        torch.testing.assert_close(one, other, atol=1e-6, rtol=0)


def test_pseudonormals_and_their_twin_agree() -> None:
    vertices, faces = star()
    topology = surface_topology(vertices, faces)
    surface = posed_surface(topology, vertices[None])
    twin = reference_surface_normals(topology, vertices[None])[:, topology.face_order]
    np.testing.assert_allclose(surface.arrays.normals, twin.numpy(), atol=2e-5)


def test_gradient_is_the_outward_direction() -> None:
    points = (torch.tensor([[0.2, 0, 0], [0, 0, 0.05], [0, -0.13, 0.02]], dtype=torch.float64)[None]).requires_grad_()
    signed_distance(points, sphere_surface(dtype=torch.float64)).sum().backward()
    assert points.grad is not None
    outward = torch.nn.functional.normalize(points.detach(), dim=-1)
    assert torch.nn.functional.cosine_similarity(points.grad, outward, dim=-1).min() > 0.98
    torch.testing.assert_close(points.grad.norm(dim=-1), torch.ones(1, 3, dtype=torch.float64))


def test_open_and_flipped_meshes_are_refused() -> None:
    _, faces = sphere_mesh()
    with pytest.raises(ValueError, match="closed mesh"):
        opposite_faces(faces[1:])
    flipped = faces.clone()
    flipped[0] = flipped[0].flip(0)
    with pytest.raises(ValueError, match="closed mesh"):
        opposite_faces(flipped)


@pytest.mark.cuda
def test_distances_on_cuda_are_those_of_the_kernel() -> None:
    vertices, faces = star()
    surface = posed_surface(surface_topology(vertices, faces), vertices[None])
    on_cuda = signed_distance(queries(500).cuda(), surface_on("cuda", surface))
    torch.testing.assert_close(on_cuda.cpu(), signed_distance(queries(500), surface), atol=2e-6, rtol=0)


def slivers() -> tuple[torch.Tensor, torch.Tensor]:
    """A sphere with one vertex in the place of another, one on an edge between two, and one a micrometre beside one."""
    vertices, faces = sphere_mesh(count=200)
    edges = faces[:, :2]
    vertices = vertices.clone()
    vertices[edges[0, 0]] = vertices[edges[0, 1]]
    near = faces[50]
    vertices[near[0]] = 0.5 * (vertices[near[1]] + vertices[near[2]])
    vertices[faces[120, 0]] = vertices[faces[120, 1]] + 1e-6
    return vertices, faces


MESHES = [star, slivers, lambda: sphere_mesh(count=4), lambda: sphere_mesh(count=2500)]


@pytest.mark.parametrize("mesh", MESHES)
def test_the_tree_finds_what_a_search_of_all_faces_finds(mesh: Callable[[], tuple[torch.Tensor, torch.Tensor]]) -> None:
    vertices, faces = mesh()
    surface = posed_surface(surface_topology(vertices, faces), vertices[None])
    assert sorted(surface.topology.face_order) == list(range(len(faces)))
    corners, tree = one_body(surface)
    points = queries(300)[0].numpy()
    for point, leaf in zip(points, search_all(points, corners, tree)):
        distances = distances_to_faces(corners, point)
        assert distances[leaf] == pytest.approx(distances.min(), abs=1e-6)


def distances_to_faces(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    return np.sqrt([squared_distance(triangle, *point) for triangle in corners])


def one_body(surface: Surface) -> tuple[np.ndarray, Bvh]:
    arrays = surface.sample_arrays(0)
    return arrays.corners, bvh_of(arrays)


def test_limited_search_finds_just_the_faces_within_its_limit() -> None:
    vertices, faces = star()
    surface = posed_surface(surface_topology(vertices, faces), vertices[None])
    corners, tree = one_body(surface)
    workspace = search_workspace()
    points, limit = queries(1000), np.float32(0.01)
    nearest = search_all(points[0].numpy(), corners, tree)
    found = 0
    for point, distance, place in zip(points[0].numpy(), signed_distance(points, surface)[0].abs(), nearest):
        answer = nearest_face(*point, -1, limit * limit, tree, *workspace)
        if abs(distance - limit) > 1e-6:
            assert (answer >= 0) == bool(distance < limit)
        if answer >= 0:
            to_answer, to_nearest = (squared_distance(corners[each], *point) for each in (answer, place))
            assert np.sqrt(to_answer) == pytest.approx(np.sqrt(to_nearest), abs=1e-6)
            found += 1
    assert 50 < found < 950


def test_points_that_are_not_numbers_or_far_away_break_nothing() -> None:
    vertices, faces = star()
    surface = posed_surface(surface_topology(vertices, faces), vertices[None])
    wild = np.array([[np.nan, 0, 0], [1e30, -1e30, 1e30], [3e38, 0, 0], [0, 0, 1e9]], np.float32)
    places = search_all(wild, *one_body(surface))
    assert (places >= 0).all()
    assert (places < len(faces)).all()


def map_of(surface: Surface, points: torch.Tensor) -> np.ndarray:
    space = occupancy_of(surface.sample_arrays(0))
    return np.array([classify(*point, space) for point in points.numpy()])


def test_the_map_never_calls_a_point_free_or_outside_that_is_not() -> None:
    vertices, faces = sphere_mesh(count=4000)
    vertices = vertices * (2.5 + torch.sin(50 * vertices).prod(dim=1, keepdim=True))  # bulges and hollows
    surface = posed_surface(surface_topology(vertices, faces), vertices[None])
    points = 3.5 * queries(8000)[0]
    known, distance = map_of(surface, points), signed_distance(points[None], surface)[0].numpy()
    assert distance[known == FREE].min() >= FREE_DISTANCE
    assert distance[known == OUTSIDE].min() > 0
    assert (known[distance < 0] == UNKNOWN).all()
    # The map must be of use: most of the outside is known.
    assert (known[distance > 0.02] == FREE).mean() > 0.98
    assert (known[(distance > 0) & (distance < 0.02)] == UNKNOWN).mean() < 0.6
    assert (known == OUTSIDE).sum() > 20


def test_a_cavity_is_not_called_outside() -> None:
    inner, faces = sphere_mesh(0.2)
    outer, _ = sphere_mesh(0.3)
    vertices = torch.cat([outer, inner])
    surface = posed_surface(surface_topology(vertices, torch.cat([faces, faces.flip(1) + len(outer)])), vertices[None])
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0.193, 0], [0.25, 0, 0], [0.35, 0, 0], [2.0, 0, 0]])
    assert list(map_of(surface, points)) == [UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, FREE, UNKNOWN]


def test_distance_and_sign_on_posed_bodies_are_those_of_libigl() -> None:
    body = load_body()
    poses, shapes = PoseSampler(load_pose_prior()).sample(2, 1, torch.Generator().manual_seed(0))
    surface = BodyBatch(body, poses, shapes).surface
    # All over the skin and on either side of it: armpits, neck, behind the ears.
    generator = torch.Generator().manual_seed(1)
    vertices = surface.vertices[:, torch.randint(surface.vertices.shape[1], (3000,), generator=generator)]
    points = vertices + 0.03 * (2 * torch.rand(vertices.shape, generator=generator) - 1)
    found = signed_distance(points, surface).numpy()
    for sample in range(2):
        exact = igl.signed_distance(
            points[sample].double().numpy(),
            surface.vertices[sample].double().numpy(),
            surface.topology.faces.numpy(),
            sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL,
        )[0]
        assert 0.2 < (exact < 0).mean() < 0.8
        np.testing.assert_allclose(np.abs(found[sample]), np.abs(exact), atol=1e-5)
        assert ((found[sample] < 0) == (exact < 0))[np.abs(exact) > 1e-5].all()
        space = occupancy_of(surface.sample_arrays(sample))
        known = np.array([classify(*point, space) for point in points[sample].numpy()])
        assert exact[known == FREE].min() >= FREE_DISTANCE - 1e-6
        assert exact[known == OUTSIDE].min() > 0
        assert (known == OUTSIDE).sum() > 100
