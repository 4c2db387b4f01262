"""Strands projected out of the skin after the network, which reads a point-sampled one.

From the root to the tip, every `spacing` or at every vertex, an edge whose end is in the skin, or closer to it than its
clearance, is rotated towards the nearest face's normal until it is as far away, and what hangs on it moves along: the
projection of position-based dynamics (Mueller et al. 2007) with lengths kept. That leaves bends at single vertices,
which are then relaxed relative to the strand as it came (`quaffure.model.bend_relaxation`), and what that moves is
pushed again, up to `pushes` times. The last step is a relaxation, too stiff to take more than some hundredths of a
percent of the vertices back in. Strands without contact stay as they are, to the bit, and no strand depends on another.
"""

import math
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.collision_skin import CollisionSkin
from quaffure.geometry.mesh import face_normals
from quaffure.geometry.triangle_grid import NONE
from quaffure.geometry.triangle_leaves import TriangleLeaves, nearest_in_band, triangle_leaves
from quaffure.model.bend_relaxation import relaxed_edges
from quaffure.model.network_config import ProjectionConfig
from quaffure.model.prepared_groom import PreparedGroom
from quaffure.model.projection_kernel import LEAST_RELAXED, PushedRods, PushSettings, push_out
from quaffure.types import Bool, Float, RestLengths, Tensor

_FARTHEST = 1e4  # of body and hair from the head [m]; beyond, a network or its input has blown up


def push_settings(config: ProjectionConfig, stiffness: float | Tensor) -> PushSettings:
    """Settings as the kernel takes them.

    Args:
        stiffness: of all joints; one for each is in the groom (`PreparedGroom.stiffened`).
    """
    return PushSettings(
        config.pushes,
        np.float32(config.spacing),
        np.float32(config.max_push / math.hypot(1, config.max_push)),
        np.float32(config.push_relaxation),
        np.float32(config.contact_stiffness),
        np.float32(1.0 if isinstance(stiffness, Tensor) else stiffness),
    )


def project_reference(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    groom: PreparedGroom,
    skin: CollisionSkin,
    settings: PushSettings,
) -> Float[Tensor, "s n 3"]:
    """Torch twin of `project`, for any device; its grid has no end."""
    corners = vertices[skin.faces]
    leaves = triangle_leaves(corners, torch.arange(len(corners), device=corners.device))
    faces = _Faces(corners, leaves, face_normals(corners), torch.from_numpy(skin.band).to(deformed))
    hair, rows = deformed.clone(), torch.arange(len(deformed), device=deformed.device)
    free = torch.nn.functional.normalize(deformed.diff(dim=1), dim=-1)
    for _ in range(settings.pushes):
        lengths = groom.rest_length[rows]
        swept, pushed = _sweep(hair[rows], lengths, groom.clearance[rows], faces, settings)
        rows, lengths, swept = rows[pushed], lengths[pushed], swept[pushed]
        hair[rows] = swept
        if len(rows) == 0 or settings.push_relaxation == 0:
            break
        joints = float(settings.stiffness) * groom.rods.bending[rows]
        contact = float(settings.contact_stiffness) * lengths.square()
        hold = torch.maximum(joints / float(settings.push_relaxation), contact) + groom.rods.goal[rows]
        edges = torch.nn.functional.normalize(swept.diff(dim=1), dim=-1)
        steps = lengths[..., None] * relaxed_edges(edges, free[rows], joints, hold)
        hair[rows, 1:] = swept[:, :1] + steps.cumsum(dim=1)
        rows = rows[(hair[rows] - swept).norm(dim=-1).amax(dim=1) >= LEAST_RELAXED]
    return hair


class _Faces(NamedTuple):
    """Faces of the skin: corners, their leaves, normals, and how far below and above each counts."""

    corners: Float[Tensor, "k 3 3"]
    leaves: TriangleLeaves
    normals: Float[Tensor, "k 3"]
    band: Float[Tensor, "k 2"]


def _sweep(
    hair: Float[Tensor, "s n 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    faces: _Faces,
    settings: PushSettings,
) -> tuple[Float[Tensor, "s n 3"], Bool[Tensor, " s"]]:
    """Strands pushed out from the root to the tip, and which ones were."""
    until_query, out = torch.zeros_like(rest_length[:, 0]), [hair[:, 0]]
    moved, shift, edges = torch.zeros_like(until_query).bool(), torch.zeros_like(hair[:, 0]), rest_length.shape[1]
    for edge in range(edges):
        position, length = hair[:, edge + 1] + shift, rest_length[:, edge]
        until_query = until_query - length
        queried = (until_query < 0) | (edge == edges - 1)
        height, face = position.new_ones(len(position)), torch.full((len(position),), NONE, device=position.device)
        height[queried], face[queried] = nearest_in_band(position[queried], faces.corners, faces.leaves, faces.band)
        until_query = torch.where(queried, float(settings.spacing) - 0.5 * length, until_query)
        push, vector, normal = clearance[:, edge + 1] - height, position - out[-1], faces.normals[face]
        along = (vector * normal).sum(-1)
        across = vector - along[:, None] * normal
        # As in `lifted_edge`: an edge straight into the skin may leave it in any direction.
        axis = torch.nn.functional.one_hot((normal[:, 0].abs() >= 0.7).long(), 3).to(normal)
        is_straight = across.square().sum(-1) < 1e-10 * length.square()
        across = torch.where(is_straight[:, None], axis - (axis * normal).sum(-1, keepdim=True) * normal, across)
        across = torch.nn.functional.normalize(across, dim=-1)
        rise = ((along + push) / length).clamp(min=-1, max=float(settings.most_rise))[:, None]
        rotated = out[-1] + length[:, None] * (rise * normal + (1 - rise.square()).sqrt() * across)
        pushed = (face >= 0) & (push > 0)
        out.append(torch.where(pushed[:, None], rotated, position))
        shift, moved = shift + out[-1] - position, moved | pushed
    return torch.stack(out, dim=1), moved


def project(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rods: PushedRods,
    skin: CollisionSkin,
    centre: Float[Tensor, "3"],
    settings: PushSettings,
) -> Float[Tensor, "s n 3"]:
    """Strands of one groom projected out of the skin [m]; float32, on the CPU.

    Args:
        deformed: vertices [m]; where any is not finite, all stay as they are.
        vertices: of `skin`, posed [m].
        centre: of the head [m]; what is outside of a `TriangleGrid` round it stays as it is.
    """
    # A comparison with NaN is false.
    if not ((vertices - centre).abs().max() < _FARTHEST and (deformed - centre).abs().max() < _FARTHEST):
        return deformed
    body = vertices.numpy(), skin.faces.numpy(), skin.band, centre.numpy()
    return torch.from_numpy(push_out(deformed.numpy(), rods, settings, *body))
