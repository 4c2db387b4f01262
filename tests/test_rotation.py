"""Rotations: round trips, group axioms, the edge cases at zero, near pi and between opposite vectors."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.rods.rod_validation import matrix_from_quaternion
from quaffure.geometry import (
    axis_angle_from_matrix,
    cross_product_matrix,
    matrix_from_axis_angle,
    quaternion_from_matrix,
    quaternion_multiply,
)
from quaffure.geometry.rotation import interpolate_rotations, shortest_arc
from quaffure.geometry.rotation_kernel import write_rotation

coordinates = st.floats(-1, 1, allow_nan=False).filter(lambda x: x == 0 or abs(x) > 1e-3)
directions = (
    st.tuples(coordinates, coordinates, coordinates)
    .filter(lambda v: math.hypot(*v) > 1e-2)
    .map(lambda v: torch.tensor(v, dtype=torch.float64))
    .map(lambda v: v / v.norm())
)
angles = st.one_of(
    st.floats(0, math.pi - 1e-6),
    st.floats(-6, -1).map(lambda e: math.pi - 10**e),
    st.floats(-9, -1).map(lambda e: 10**e),
)
axis_angles = st.builds(lambda direction, angle: direction * angle, directions, angles)
few = settings(max_examples=60, deadline=None)


@few
@given(axis_angles)
def test_axis_angle_and_quaternion_round_trips(axis_angle: torch.Tensor) -> None:
    matrix = matrix_from_axis_angle(axis_angle)
    torch.testing.assert_close(matrix @ matrix.T, torch.eye(3, dtype=torch.float64), atol=1e-12, rtol=0)
    assert torch.linalg.det(matrix) > 0
    torch.testing.assert_close(axis_angle_from_matrix(matrix), axis_angle, atol=1e-7, rtol=0)
    torch.testing.assert_close(matrix_from_quaternion(quaternion_from_matrix(matrix)), matrix, atol=1e-12, rtol=0)


@few
@given(directions, angles)
def test_a_rotation_turns_right_handed_about_its_axis(axis: torch.Tensor, angle: float) -> None:
    across = torch.linalg.cross(axis, torch.roll(axis, 1) + torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64))
    turned = matrix_from_axis_angle(axis * angle) @ across
    expected = math.cos(angle) * across + math.sin(angle) * torch.linalg.cross(axis, across)
    torch.testing.assert_close(turned, expected, atol=1e-9, rtol=0)


@few
@given(axis_angles)
def test_compiled_rotation_is_that_of_the_reference(axis_angle: torch.Tensor) -> None:
    assert_rotation_is_compiled_alike(axis_angle, atol=1e-12)


@pytest.mark.parametrize("angle", [1e-5, 9e-4, 1.1e-3])
def test_compiled_rotation_of_a_small_angle_is_that_of_the_reference(angle: float) -> None:
    assert_rotation_is_compiled_alike(torch.tensor([2.0, -1.0, 2.0], dtype=torch.float64) * (angle / 3), atol=1e-15)


def assert_rotation_is_compiled_alike(axis_angle: torch.Tensor, atol: float) -> None:
    matrix = np.empty((3, 3))
    write_rotation(axis_angle.numpy(), matrix)
    np.testing.assert_allclose(matrix, matrix_from_axis_angle(axis_angle).numpy(), rtol=0, atol=atol)


@few
@given(axis_angles, axis_angles, axis_angles)
def test_quaternions_multiply_as_matrices_do(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> None:
    matrices = [matrix_from_axis_angle(x) for x in (a, b, c)]
    first, second, third = (quaternion_from_matrix(m) for m in matrices)
    product = quaternion_multiply(first, second)
    torch.testing.assert_close(matrix_from_quaternion(product), matrices[0] @ matrices[1], atol=1e-12, rtol=0)
    torch.testing.assert_close(
        quaternion_multiply(product, third),
        quaternion_multiply(first, quaternion_multiply(second, third)),
        atol=1e-12,
        rtol=0,
    )
    inverse = first * torch.tensor([1.0, -1.0, -1.0, -1.0], dtype=torch.float64)
    unit = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(quaternion_multiply(first, inverse), unit, atol=1e-12, rtol=0)


@few
@given(directions, directions)
def test_shortest_arc_takes_one_to_the_other(a: torch.Tensor, b: torch.Tensor) -> None:
    matrix = shortest_arc(a, b)
    torch.testing.assert_close(matrix @ a, b, atol=2e-4, rtol=0)
    torch.testing.assert_close(matrix @ matrix.T, torch.eye(3, dtype=torch.float64), atol=1e-12, rtol=0)
    if (a + b).norm() > 1e-2:  # the axis of opposite vectors is free
        axis = torch.linalg.cross(a, b)
        torch.testing.assert_close(matrix @ axis, axis, atol=1e-9, rtol=0)


def test_shortest_arc_of_opposite_vectors_is_a_half_turn() -> None:
    a = torch.eye(3)
    matrix = shortest_arc(a, -a)
    torch.testing.assert_close((matrix @ a[..., None])[..., 0], -a)
    torch.testing.assert_close(torch.linalg.det(matrix), torch.ones(3))


@few
@given(axis_angles, axis_angles, st.floats(0, 1))
def test_interpolation_keeps_its_ends_and_its_speed(a: torch.Tensor, b: torch.Tensor, t: float) -> None:
    start, end = matrix_from_axis_angle(a), matrix_from_axis_angle(b)
    time = torch.tensor([0.0, t, 1.0], dtype=torch.float64)
    middle = interpolate_rotations(start, end, time)
    torch.testing.assert_close(middle[0], start, atol=1e-12, rtol=0)
    torch.testing.assert_close(middle[2], end, atol=1e-7, rtol=0)
    whole = axis_angle_from_matrix(start.T @ end).norm()
    torch.testing.assert_close(axis_angle_from_matrix(start.T @ middle[1]).norm(), t * whole, atol=1e-7, rtol=0)


def test_gradient_at_zero_is_the_cross_product_matrix() -> None:
    jacobian = torch.autograd.functional.jacobian(matrix_from_axis_angle, torch.zeros(3, dtype=torch.float64))
    for direction in torch.eye(3, dtype=torch.float64):
        torch.testing.assert_close(jacobian @ direction, cross_product_matrix(direction))


@pytest.mark.parametrize("length", [1e-3, 0.0099, 0.0101, 1.0, 3.1])
def test_gradcheck_through_both_directions(length: float) -> None:
    axis = torch.tensor([[2.0, -1.0, 2.0]], dtype=torch.float64) / 3
    axis_angle = (length * axis).requires_grad_()
    assert torch.autograd.gradcheck(matrix_from_axis_angle, axis_angle)
    assert torch.autograd.gradcheck(lambda x: axis_angle_from_matrix(matrix_from_axis_angle(x)), axis_angle)


def test_gradients_are_finite_for_identity_and_opposite_vectors() -> None:
    matrix = torch.eye(3)[None].requires_grad_()
    axis_angle_from_matrix(matrix).sum().backward()
    a = torch.tensor([[0.0, 0.0, 1.0]], requires_grad=True)
    shortest_arc(a, -a).sum().backward()
    assert matrix.grad is not None
    assert a.grad is not None
    assert matrix.grad.isfinite().all()
    assert a.grad.isfinite().all()


def test_float32_half_turns_keep_their_axis() -> None:
    axis = torch.nn.functional.normalize(torch.randn(200, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    matrix = matrix_from_axis_angle(axis * math.pi)
    found = axis_angle_from_matrix(matrix)
    aligned = (found * axis).sum(-1).abs() / math.pi
    torch.testing.assert_close(aligned, torch.ones(200), atol=1e-5, rtol=0)
