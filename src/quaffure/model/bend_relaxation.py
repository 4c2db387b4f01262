"""Bends of strands relaxed after contact, torch.

Contact is resolved edge by edge from the root (`quaffure.geometry.mls_surface`), which leaves a bend at every vertex
that touches, where a rod would bend over a length. With b_i the bend at the joint before edge i beyond that of the
strand without contact, as a rotation vector, the rotations theta of the edges minimize

    sum_i  B_i / 2 |b_i + theta_i - theta_(i-1)|^2  +  H_i / 2 |theta_i|^2

so that bends spread over sqrt(B / H) joints or so, while each edge stays near its direction. In the initial shape
H = B / r + G, with G of what holds an edge; in the projection H = max(B / r, k l^2) + G, with the contact stiffness k
and the edge's length l. A strand that touches nothing stays as it is. Compiled twins: `bend_relaxation_lanes`, and for
one strand `projection_kernel`.
"""

import torch

from quaffure.geometry.rotation import quaternion_multiply, rotate_by_gibbs
from quaffure.model.bend_relaxation_kernel import LEAST_ALIGNMENT
from quaffure.model.free_rod import no_rotation, rotate
from quaffure.types import Float, Tensor


def relaxed_edges(
    edges: Float[Tensor, "*b e 3"],
    free: Float[Tensor, "*b e 3"],
    bending: Float[Tensor, "*s e"],
    hold: Float[Tensor, "*s e"],
) -> Float[Tensor, "*b e 3"]:
    """Unit edges with relaxed bends.

    Args:
        edges, free: unit edges after contact and without it.
        bending: B of each joint [m^2], see `FreeRods`.
        hold: H, resistance of each edge to being turned [m^2].
    """
    stiffness, slope = torch.zeros_like(bending[..., 0, None]), torch.zeros_like(edges[..., 0, :])
    found: list[tuple[Tensor, Tensor]] = []
    for edge, bend in reversed([*enumerate(bends(edges, free).unbind(-2))]):
        joint = bending[..., edge, None]
        own = hold[..., edge, None] + stiffness
        found.append((joint / (joint + own), (joint * bend + slope) / (joint + own)))
        stiffness, slope = joint * own / (joint + own), joint * (slope - own * bend) / (joint + own)
    theta, thetas = torch.zeros_like(slope), []
    for follows, shift in reversed(found):
        theta = follows * theta - shift
        thetas.append(theta)
    return rotate_by_gibbs(0.5 * torch.stack(thetas, dim=-2), edges)


def bends(edges: Float[Tensor, "*b e 3"], free: Float[Tensor, "*b e 3"]) -> Float[Tensor, "*b e 3"]:
    """Rotation vectors, to first order, from where each edge were with the bend without contact before it."""
    rotation, found = no_rotation(edges[..., 0, :]), []
    for direction, unbent in zip(edges.unbind(-2), free.unbind(-2)):
        expected = rotate(rotation, unbent)
        real = (1 + (expected * direction).sum(-1, keepdim=True)).clamp(min=LEAST_ALIGNMENT)
        bend = torch.cat([real, torch.linalg.cross(expected, direction)], dim=-1)
        bend = torch.nn.functional.normalize(bend, dim=-1)
        rotation = quaternion_multiply(bend, rotation)
        found.append(2 * bend[..., 1:])
    return torch.stack(found, dim=-2)
