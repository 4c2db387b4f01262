"""Strands projected out of the skin after the network, which reads a point-sampled one.

From the root to the tip, every `spacing` or at every vertex, an edge whose end is in the skin, or closer to it than its
clearance, is rotated out along the nearest face's normal, and what hangs on it moves along: the projection of
position-based dynamics (Mueller et al. 2007) with lengths kept. Strands without contact stay as they are, to the bit,
and no strand depends on another.
"""

import numpy as np
import torch

from quaffure.body.collision_skin import CollisionSkin
from quaffure.geometry.mesh import face_normals
from quaffure.geometry.triangle_grid import NONE
from quaffure.geometry.triangle_leaves import nearest_in_band, triangle_leaves
from quaffure.model.network_config import ProjectionConfig
from quaffure.model.projection_kernel import ProjectedStrands, push_out
from quaffure.types import Float, RestLengths, Tensor

_FARTHEST = 1e4  # of body and hair from the head [m]; beyond, a network or its input has blown up


def project_reference(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: CollisionSkin,
    config: ProjectionConfig,
) -> Float[Tensor, "s n 3"]:
    """Torch twin of `project`, for any device; its grid has no end."""
    band, corners = torch.from_numpy(skin.band).to(deformed), vertices[skin.faces]
    leaves, normals = triangle_leaves(corners, torch.arange(len(corners), device=corners.device)), face_normals(corners)
    free, out = torch.zeros_like(rest_length[:, 0]), [deformed[:, 0]]
    shift, edges = torch.zeros_like(deformed[:, 0]), rest_length.shape[1]
    for edge in range(edges):
        position, length = deformed[:, edge + 1] + shift, rest_length[:, edge]
        free = free - length
        queried = (free < 0) | (edge == edges - 1)
        height, face = position.new_ones(len(position)), torch.full((len(position),), NONE, device=position.device)
        height[queried], face[queried] = nearest_in_band(position[queried], corners, leaves, band)
        free = torch.where(queried, config.spacing - 0.5 * length, free)
        push = (clearance[:, edge + 1] - height).clamp(max=config.max_push * length)
        vector = position + push[:, None] * normals[face] - out[-1]
        rotated = out[-1] + length[:, None] * torch.nn.functional.normalize(vector, dim=-1)
        out.append(torch.where(((face >= 0) & (push > 0))[:, None], rotated, position))
        shift = shift + out[-1] - position
    return torch.stack(out, dim=1)


def project(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: CollisionSkin,
    centre: Float[Tensor, "3"],
    config: ProjectionConfig,
) -> Float[Tensor, "s n 3"]:
    """Strands of one groom projected out of the skin [m]; float32, on the CPU.

    Args:
        deformed: vertices [m]; where any is not finite, all stay as they are.
        vertices: of `skin`, posed [m].
        rest_length: of the strands' edges [m].
        clearance: distance from the skin that each vertex is to keep [m], not above the band of `skin`.
        centre: of the head [m]; what is outside of a `TriangleGrid` round it stays as it is.
    """
    # A comparison with NaN is false.
    if not ((vertices - centre).abs().max() < _FARTHEST and (deformed - centre).abs().max() < _FARTHEST):
        return deformed
    strands = (deformed.numpy(), rest_length.numpy(), clearance.numpy())
    scalars = np.float32(config.spacing), np.float32(config.max_push)
    body = vertices.numpy(), skin.faces.numpy(), skin.band, centre.numpy()
    return torch.from_numpy(push_out(ProjectedStrands(*strands, *scalars), *body))
