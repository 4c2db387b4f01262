import igl
import numpy as np
import pytest
import torch

from quaffure.geometry.mesh import opposite_faces
from quaffure.geometry.signed_distance import foot_points, foot_points_reference, signed_distance
from quaffure.geometry.surface import posed_surface, reference_surface_normals, surface_topology
from tests.scenes import sphere_mesh, sphere_surface


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
    kernel, twin = foot_points(points, surface), foot_points_reference(points, surface)
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


def test_pseudonormals_and_their_twin_agree() -> None:
    vertices, faces = star()
    topology = surface_topology(vertices, faces)
    surface = posed_surface(topology, vertices[None])
    twin = reference_surface_normals(topology, vertices[None])[:, topology.tree.face_order]
    np.testing.assert_allclose(surface.normals, twin.numpy(), atol=2e-5)


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
def test_twin_runs_on_cuda() -> None:
    surface = sphere_surface()
    on_cuda = foot_points_reference(queries(100).cuda(), surface)
    torch.testing.assert_close(
        on_cuda.barycentric.cpu(), foot_points(queries(100), surface).barycentric, atol=1e-4, rtol=0
    )
