"""Rotations: axis-angle vectors [rad], unit quaternions `wxyz` and matrices, all with safe gradients.

Every function works on any leading axes and any float dtype. A matrix acts on column vectors: `world = matrix @ local`.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from quaffure.geometry.rotation_kernel import LEAST_ALIGNMENT

# Below this square of an angle [rad^2] the Taylor series of the coefficients are exact to float32 (next term < 1e-9).
SMALL_ANGLE_SQUARED = 1e-4
# Below this length of a + b, the mid-direction of two unit vectors is mere rounding.
ANTIPARALLEL_LENGTH = 1e-4


def cross_product_matrix(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The matrix K with K @ x = vector x x (cross product)."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def matrix_from_axis_angle(axis_angle: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of axis-angle vectors [rad] (Rodrigues' formula); the gradient at zero is exact."""
    angle_squared = axis_angle.square().sum(-1)[..., None, None]
    small = angle_squared < SMALL_ANGLE_SQUARED
    # The branch not taken must stay finite too, or its NaN gradient leaks through torch.where.
    safe_squared = torch.where(small, torch.ones_like(angle_squared), angle_squared)
    angle = safe_squared.sqrt()
    sine_ratio = torch.where(small, 1 - angle_squared / 6 + angle_squared**2 / 120, angle.sin() / angle)
    cosine_ratio = torch.where(
        small, 0.5 - angle_squared / 24 + angle_squared**2 / 720, 2 * (0.5 * angle).sin() ** 2 / safe_squared
    )
    cross = cross_product_matrix(axis_angle)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + sine_ratio * cross + cosine_ratio * (cross @ cross)


def axis_angle_from_matrix(matrix: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Axis-angle vectors [rad] of rotation matrices, of length at most pi; accurate near zero and near pi alike."""
    quaternion = quaternion_from_matrix(matrix)
    scalar, vector = quaternion[..., :1], quaternion[..., 1:]
    sine_squared = vector.square().sum(-1, keepdim=True)
    small = sine_squared < SMALL_ANGLE_SQUARED / 4
    safe_sine = torch.where(small, torch.ones_like(sine_squared), sine_squared).sqrt()
    ratio = torch.where(small, 2 + sine_squared / 3, 2 * torch.atan2(safe_sine, scalar) / safe_sine)
    return ratio * vector


def quaternion_from_matrix(matrix: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Unit quaternions `wxyz`, w >= 0, of rotation matrices.

    The rows below are the quaternion times four of each of its own components; the row of the largest
    component is normalised, so nothing is ever divided by a small number.
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in matrix.unbind(-2))
    scaled = torch.stack(
        [
            torch.stack([1 + a + e + i, h - f, c - g, d - b], dim=-1),
            torch.stack([h - f, 1 + a - e - i, b + d, c + g], dim=-1),
            torch.stack([c - g, b + d, 1 - a + e - i, f + h], dim=-1),
            torch.stack([d - b, c + g, f + h, 1 - a - e + i], dim=-1),
        ],
        dim=-2,
    )
    largest = scaled.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*scaled.shape[:-2], 1, 4)
    quaternion = torch.nn.functional.normalize(scaled.gather(-2, largest).squeeze(-2), dim=-1)
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def quaternion_multiply(
    left: Float[Tensor, "*#batch 4"], right: Float[Tensor, "*#batch 4"]
) -> Float[Tensor, "*batch 4"]:
    """Hamilton product of quaternions `wxyz`: the rotation `right` followed by `left`."""
    left, right = torch.broadcast_tensors(left, right)
    left_scalar, left_vector = left[..., :1], left[..., 1:]
    right_scalar, right_vector = right[..., :1], right[..., 1:]
    scalar = left_scalar * right_scalar - (left_vector * right_vector).sum(-1, keepdim=True)
    cross = torch.linalg.cross(left_vector, right_vector)
    return torch.cat([scalar, left_scalar * right_vector + right_scalar * left_vector + cross], dim=-1)


def shortest_arc(a: Float[Tensor, "*#batch 3"], b: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The rotation by the smallest angle that takes unit vector `a` to unit vector `b`.

    Two half turns, about `a` and then about the direction midway to `b`: orthonormal to rounding whatever
    the vectors. Opposite vectors turn about some axis across `a`.
    """
    a, b = torch.broadcast_tensors(a, b)
    middle = a + b
    opposite = middle.norm(dim=-1, keepdim=True) < ANTIPARALLEL_LENGTH
    middle = torch.nn.functional.normalize(torch.where(opposite, any_normal(a), middle), dim=-1)
    return _half_turn(middle) @ _half_turn(torch.nn.functional.normalize(a, dim=-1))


def gibbs_vector(a: Float[Tensor, "*batch 3"], b: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The smallest rotation from unit vector `a` to `b`: its axis times the tangent of half its angle.

    Too short beyond 154 degrees.
    """
    alignment = 1 + (a * b).sum(-1, keepdim=True)
    return torch.linalg.cross(a, b) / alignment.clamp(min=LEAST_ALIGNMENT)


def rotate_by_gibbs(gibbs: Float[Tensor, "*batch 3"], vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """A vector rotated by a Gibbs vector (Rodrigues 1840)."""
    cross = torch.linalg.cross(gibbs, vector, dim=-1)
    return vector + 2 * (cross + torch.linalg.cross(gibbs, cross, dim=-1)) / (1 + gibbs.square().sum(-1, keepdim=True))


def interpolate_rotations(
    a: Float[Tensor, "*#batch 3 3"], b: Float[Tensor, "*#batch 3 3"], t: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3 3"]:
    """Rotations on the shortest way from `a` (t = 0) to `b` (t = 1) at constant speed: spherical interpolation."""
    return a @ matrix_from_axis_angle(t[..., None] * axis_angle_from_matrix(a.transpose(-1, -2) @ b))


def _half_turn(axis: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    identity = torch.eye(3, dtype=axis.dtype, device=axis.device)
    return 2 * axis[..., :, None] * axis[..., None, :] - identity


def any_normal(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Some unit vector across a unit vector: the axis that it leans to least, made perpendicular."""
    axis = torch.nn.functional.one_hot(direction.abs().argmin(-1), 3).to(direction)
    return torch.nn.functional.normalize(axis - (axis * direction).sum(-1, keepdim=True) * direction, dim=-1)
