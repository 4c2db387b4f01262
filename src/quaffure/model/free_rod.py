"""Equilibrium of strands without contact, an estimate by Gauss-Newton passes in rotations of the edges; torch.

Every edge has a rotation R_i from where the posed design has it, t_i = R_i a_i. With F_i the sum of the forces on the
vertices beyond edge i, tau_i the moment that the joint before it transmits in the design and w_i the rotation vector of
R_i R_(i-1)^T, the joint transmits

    M_i = R_(i-1) tau_i + D_i w_i,    D_i = B_i (I - t_i t_i^T) + C_i t_i t_i^T

so that the design is at rest under the design's own forces, to the bit. To first order in w this is the rod of
`quaffure.energies.rod`, whose joints turn by little. A pass solves

    (theta_i - theta_(i-1))^T D_i (theta_i - theta_(i-1)) / 2 + theta_i^T (T_i + G_i) theta_i / 2 + g_i . theta_i -> min
    g_i = M_i - M_(i+1) - l_i t_i x F_i + G_i (rotation vector of R_i)
    T_i = l_i (2 |F_i| + F_i . t_i) (I - t_i t_i^T) / 3

by elimination from tip to root. T_i is the secant stiffness of an edge that is pulled along: positive at any angle, so
that a pass is a smooth function of the pose. `quaffure.model.free_rod_lanes` is the compiled twin.
"""

from typing import NamedTuple

import torch

from quaffure.geometry.rotation import quaternion_multiply
from quaffure.model.free_rod_lanes import LARGEST_HALF_TURN, LEAST_STIFFNESS, TWIST_SHARE
from quaffure.types import EdgeVectors, Float, Tensor


class FreeRods(NamedTuple):
    """Posed strands and what acts on them; forces in weights of a metre of hair.

    Attributes:
        direction: a, unit direction of every edge of the posed design.
        moment: tau, that each joint transmits in the design, in the posed axes [m^2].
        force: on the vertex at the end of every edge.
        bending: B [m^2].
        goal: G, stiffness of what holds an edge to the posed design [m^2].
        length: l of every edge [m].
    """

    direction: EdgeVectors
    moment: EdgeVectors
    force: EdgeVectors
    bending: Float[Tensor, "*s e"]
    goal: Float[Tensor, "*s e"]
    length: Float[Tensor, "*s e"]


def free_rod_directions(rods: FreeRods, passes: int) -> EdgeVectors:
    """Unit directions of the edges after some passes from the posed design."""
    rotation = no_rotation(rods.direction)
    for _ in range(passes):
        rotation = _rotated(rotation, _newton_rotations(rods, rotation))
    return rotate(rotation, rods.direction)


def no_rotation(vector: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """The quaternion 1 for each vector."""
    return torch.nn.functional.pad(vector.new_ones(*vector.shape[:-1], 1), (0, 3))


def rotate(quaternion: Float[Tensor, "*n 4"], vector: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """A vector rotated by a unit quaternion, its real part first."""
    real, imaginary = quaternion[..., :1], quaternion[..., 1:]
    twice = 2 * torch.linalg.cross(imaginary, vector)
    return vector + real * twice + torch.linalg.cross(imaginary, twice)


def _newton_rotations(rods: FreeRods, rotation: Float[Tensor, "*s e 4"]) -> EdgeVectors:
    """theta of every edge [rad]."""
    before = torch.cat([no_rotation(rods.direction[..., :1, :]), rotation[..., :-1, :]], dim=-2)
    tangent, bending, identity = rotate(rotation, rods.direction), rods.bending[..., None, None], torch.eye(3)
    along = tangent[..., :, None] * tangent[..., None, :]
    identity = identity.to(along)
    joint = bending * (identity + (TWIST_SHARE - 1) * along)
    turned = _rotation_vector(quaternion_multiply(rotation, before * before.new_tensor([1, -1, -1, -1])))
    moment = rotate(before, rods.moment) + (joint @ turned[..., None])[..., 0]
    beyond = rods.force.flip(-2).cumsum(-2).flip(-2)
    next_moment = torch.nn.functional.pad(moment[..., 1:, :], (0, 0, 0, 1))
    torque = rods.length[..., None] * torch.linalg.cross(tangent, beyond)
    gradient = moment - next_moment - torque + rods.goal[..., None] * _rotation_vector(rotation)
    pull = rods.length * (2 * beyond.norm(dim=-1) + (beyond * tangent).sum(-1)) / 3
    least = (rods.goal + LEAST_STIFFNESS * rods.bending)[..., None, None]
    own = pull[..., None, None] * (identity - along) + least * identity
    return _eliminated(joint, own, gradient)


def _eliminated(joint: Tensor, own: Tensor, gradient: EdgeVectors) -> EdgeVectors:
    """Minimum of the chain's quadratic function, from its blocks D and T + G."""
    state, carry = torch.zeros_like(own[..., 0, :, :]), torch.zeros_like(gradient[..., 0, :])
    found: list[tuple[Tensor, Tensor]] = []
    for edge in reversed(range(gradient.shape[-2])):
        free, slope = state + own[..., edge, :, :], carry + gradient[..., edge, :]
        inverse = torch.linalg.inv(free + joint[..., edge, :, :])
        follows, shift = inverse @ free, (inverse @ slope[..., None])[..., 0]
        found.append((follows, shift))
        state, carry = free - free @ follows, slope - (free @ shift[..., None])[..., 0]
    theta, thetas = torch.zeros_like(carry), []
    for follows, shift in reversed(found):
        theta = theta - (follows @ theta[..., None])[..., 0] - shift
        thetas.append(theta)
    return torch.stack(thetas, dim=-2)


def _rotated(quaternion: Float[Tensor, "*n 4"], vector: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """Rotated further by a rotation vector, shortened where it is long."""
    half = 0.5 * vector
    square = half.square().sum(-1, keepdim=True).clamp(max=LARGEST_HALF_TURN**2)
    tangent = half * (1 + square / 3 * (1 + 0.4 * square))  # series of tan(x) / x
    turned = quaternion_multiply(torch.cat([torch.ones_like(square), tangent], dim=-1), quaternion)
    return torch.nn.functional.normalize(turned, dim=-1)


def _rotation_vector(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3"]:
    """Twice the sine of half the angle along the axis: the rotation vector to first order, and bounded."""
    sign = torch.where(quaternion[..., :1] >= 0, 2.0, -2.0).to(quaternion)
    return sign * quaternion[..., 1:]
