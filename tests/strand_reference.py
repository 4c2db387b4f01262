"""Newton's step of single strands by one dense system a strand: the slow twin of `strand_recursion`."""

import torch

from quaffure.geometry import cross_product_matrix
from quaffure.solvers.strand_recursion import LEAST_ALIGNMENT, LEAST_STIFFNESS, StrandModel
from quaffure.types import Float, Tensor


def newton_rotations_reference(model: StrandModel, k_body_collision: float) -> Float[Tensor, "s e 3"]:
    """The rotation [rad] of every edge that minimizes the model, in float64; equations in `strand_recursion`."""
    direction, bending, length, contact = (
        torch.from_numpy(field).double() for field in (model.direction, model.bending, model.length, model.contact)
    )
    strands, edges = bending.shape
    eye = torch.eye(3, dtype=torch.float64)
    across = eye - direction[..., :, None] * direction[..., None, :]
    gradient = torch.from_numpy(model.gradient + model.around_gradient).double()[:, 1:]
    force = -gradient.flip(1).cumsum(1).flip(1)
    tension = (length * (force * direction).sum(-1)).clamp(min=0) + torch.from_numpy(model.goal)
    own = tension[..., None, None] * across + float(LEAST_STIFFNESS) * bending[..., None, None] * eye
    joint = _joint_matrices(model)
    matrix = torch.zeros(strands, edges, 3, edges, 3, dtype=torch.float64)
    for edge in range(edges):
        matrix[:, edge, :, edge] += own[:, edge] + joint[:, edge]
        if edge > 0:
            matrix[:, edge - 1, :, edge - 1] += joint[:, edge]
            matrix[:, edge - 1, :, edge] -= joint[:, edge]
            matrix[:, edge, :, edge - 1] -= joint[:, edge]
    # u of vertex j + 1 is the sum over edges i <= j of l_i theta_i x t_i.
    by_rotation = -length[..., None, None] * cross_product_matrix(direction)
    reached = torch.tril(torch.ones(edges, edges, dtype=torch.float64))
    moved = torch.einsum("ji,siab->sjaib", reached, by_rotation)
    normal, stiffness = contact[:, 1:, :3], 6 * k_body_collision * contact[:, 1:, 3]
    at_vertex = stiffness[..., None, None] * normal[..., :, None] * normal[..., None, :]
    at_vertex = at_vertex + torch.from_numpy(model.around_stiffness).double()[:, 1:, None, None] * eye
    matrix += torch.einsum("sjaib,sjac,sjckd->sibkd", moved, at_vertex, moved)
    right = torch.einsum("sjaib,sja->sib", moved, gradient)
    solution = torch.linalg.solve(matrix.reshape(strands, 3 * edges, 3 * edges), right.flatten(1))
    return -solution.reshape(strands, edges, 3)


def _joint_matrices(model: StrandModel) -> Float[Tensor, "s e 3 3"]:
    """B S^T S + C w w^T of every joint, with S d = d x t - (t_before x t) (w . d) / 2."""
    direction, root_direction, bending, twisting = (
        torch.from_numpy(field).double()
        for field in (model.direction, model.root_direction, model.bending, model.twisting)
    )
    before = torch.cat([root_direction[:, None], direction[:, :-1]], dim=1)
    alignment = (1 + (direction * before).sum(-1, keepdim=True)).clamp(min=LEAST_ALIGNMENT)
    twist_axis = (direction + before) / alignment
    half = 0.5 * torch.linalg.cross(before, direction)
    strain = -cross_product_matrix(direction) - half[..., :, None] * twist_axis[..., None, :]
    bent = torch.einsum("seab,seac->sebc", strain, strain)
    twisted = twist_axis[..., :, None] * twist_axis[..., None, :]
    return bending[..., None, None] * bent + twisting[..., None, None] * twisted
