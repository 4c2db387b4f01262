"""The scalar functions that kernels inline, each against its torch reference: a flipped sign fails here first."""

import numpy as np
import pytest
import torch

from quaffure.energies import energy_body_collision
from quaffure.energies.body_collision import contact_force
from quaffure.energies.smoothing_kernel import kernel_slope, kernel_value, smoothing_kernel
from quaffure.geometry.rotation import rotate_by_gibbs
from quaffure.geometry.rotation_kernel import pushed_edge, rotated_by_gibbs
from quaffure.geometry.signed_distance import closest_barycentric
from quaffure.geometry.triangle import (
    closest_on_triangle,
    face_frame,
    signed_distance_from_offset,
    squared_distance,
    squared_distance_in_plane,
)

TRIANGLE = np.array([[0.3, -0.2, 0.5], [1.1, 0.4, 0.2], [0.2, 0.9, 0.8]])


@pytest.mark.parametrize("distance", [-0.004, 0.0, 0.001, 0.0029, 0.004])
def test_contact_force_is_the_derivative_of_its_energy(distance: float) -> None:
    d = torch.tensor([[[distance]]], dtype=torch.float64, requires_grad=True)
    expected = energy_body_collision(d, torch.tensor([[0.003]], dtype=torch.float64), 7.0)
    (slope,) = torch.autograd.grad(expected.sum(), d)
    assert contact_force(distance, 0.003, 7.0) == pytest.approx(
        (float(slope), float(expected.detach())), rel=1e-12, abs=1e-15
    )


@pytest.mark.parametrize("q", [0.2, 0.9, 1.1, 1.9, 2.1])
def test_smoothing_kernel_has_the_value_and_slope_of_its_reference(q: float) -> None:
    r = torch.tensor([q], dtype=torch.float64, requires_grad=True)
    expected = smoothing_kernel(r, 1.0)
    (slope,) = torch.autograd.grad(expected.sum(), r)
    assert (kernel_value(q), kernel_slope(q)) == pytest.approx(
        (float(expected.detach()), float(slope)), rel=1e-12, abs=1e-15
    )


def test_closest_point_of_a_triangle_is_that_of_the_reference() -> None:
    points = np.random.default_rng(0).uniform(-1, 2, (300, 3))
    triangle = torch.from_numpy(TRIANGLE)
    barycentric, feature = closest_barycentric(torch.from_numpy(points), triangle.expand(300, 3, 3))
    feet = (barycentric[..., None] * triangle).sum(-2).numpy()
    assert set(feature.tolist()) == set(range(7))
    frame = face_frame(TRIANGLE)
    normal, along, across = (np.array(frame[3 * k : 3 * k + 3]) for k in range(3))
    np.testing.assert_allclose(np.cross(TRIANGLE[1] - TRIANGLE[0], TRIANGLE[2] - TRIANGLE[0]), normal * frame[14])
    for point, foot, expected in zip(points, feet, feature.tolist()):
        *found, found_feature = closest_on_triangle(TRIANGLE, *point)
        np.testing.assert_allclose(found, foot, atol=1e-12)
        assert found_feature == expected
        square = ((point - foot) ** 2).sum()
        assert squared_distance(TRIANGLE, *point) == pytest.approx(square)
        offset = point - TRIANGLE[0]
        in_plane = squared_distance_in_plane(offset @ along, offset @ across, *frame[9:14])
        assert (offset @ normal) ** 2 + in_plane == pytest.approx(square)


def test_signed_distance_is_positive_outside_with_an_outward_gradient() -> None:
    offset, unit = np.array([0.2, -0.1, 0.4]), np.array([0.2, -0.1, 0.4]) / 0.21**0.5
    normal = np.array([1.0, 0.5, 3.0])
    for side in (1, -1):
        signed, *gradient = signed_distance_from_offset(*(side * offset), *normal)
        assert signed == pytest.approx(side * 0.21**0.5)
        np.testing.assert_allclose(gradient, unit)
    signed, *gradient = signed_distance_from_offset(0.0, 0.0, 0.0, *normal)
    assert signed == 0
    np.testing.assert_allclose(gradient, normal / np.linalg.norm(normal))


def test_rotation_by_a_gibbs_vector_is_that_of_the_reference() -> None:
    gibbs, vector = np.random.default_rng(0).normal(size=(2, 20, 3)).astype(np.float32)
    expected = rotate_by_gibbs(torch.from_numpy(gibbs), torch.from_numpy(vector)).numpy()
    found = [rotated_by_gibbs(tuple(g), tuple(v)) for g, v in zip(gibbs, vector)]
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_a_pushed_edge_keeps_its_length_and_leans_along_the_push() -> None:
    start, end, normal = np.random.default_rng(1).normal(size=(3, 3)).astype(np.float32)
    push, length = np.float32(0.4), np.float32(0.03)
    expected = end + push * normal - start
    found = pushed_edge(tuple(start), tuple(end), tuple(normal), push, length)
    np.testing.assert_allclose(found, length * expected / np.linalg.norm(expected), rtol=1e-5)
