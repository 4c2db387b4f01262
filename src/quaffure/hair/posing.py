"""Pose-based groom transform, Sec. 3.3: every strand moves rigidly with its scalp triangle."""

import torch

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.hair.groom import Groom
from quaffure.types import Float, MeshVertices, Positions, Tensor


def triangle_frames(triangles: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 3 3"]:
    """Right-handed orthonormal frames of triangles, columns: first edge, in-plane normal to it, outward normal."""
    first, second, third = triangles.unbind(-2)
    along = torch.nn.functional.normalize(second - first, dim=-1)
    normal = torch.nn.functional.normalize(torch.linalg.cross(second - first, third - first), dim=-1)
    return torch.stack([along, torch.linalg.cross(normal, along), normal], dim=-1)


def root_positions(groom: Groom, vertices: MeshVertices, body: BodyModel) -> Float[Tensor, "b s 3"]:
    """Positions of the roots on posed bodies [m]."""
    triangles = vertices[:, body.faces[groom.root_faces]]
    return (groom.root_barycentric[..., None] * triangles).sum(-2)


def root_rotations(groom: Groom, posed: PosedBody, body: BodyModel) -> Float[Tensor, "b s 3 3"]:
    """Rotation of every strand's scalp triangle from the rest body to the posed body (world_from_rest)."""
    carriers = body.faces[groom.root_faces]
    rest = triangle_frames(body.rest_vertices[carriers])
    return triangle_frames(posed.vertices[:, carriers]) @ rest.mT


def rigid_rotations(groom: Groom, posed: Positions) -> Float[Tensor, "b s 3 3"]:
    """Rotation of every strand from rest to a rigidly posed strand, fitted (Kabsch).

    The rotation of a straight strand about itself is not determined.
    """
    edges = groom.rest_strands.diff(dim=1).to(posed)
    u, _, vh = torch.linalg.svd(torch.einsum("bsni,snj->bsij", posed.diff(dim=2), edges))
    sign = torch.ones_like(u[..., 0])
    sign[..., 2] = torch.linalg.det(u @ vh).sign()
    return (u * sign[..., None, :]) @ vh


def posed_strands(
    groom: Groom, posed: PosedBody, body: BodyModel, rotation: Float[Tensor, "b s 3 3"] | None = None
) -> Positions:
    """The groom moved rigidly, strand by strand, with its scalp triangles (x_posed) [m, world].

    Args:
        groom: registered to `body`.
        posed: a batch of poses and shapes of `body`.
        rotation: `root_rotations` of the same, where they are known already.
    """
    rest_roots = root_positions(groom, body.rest_vertices[None], body)[0]
    offsets = groom.rest_strands - rest_roots[:, None]
    rotation = root_rotations(groom, posed, body) if rotation is None else rotation
    return offsets @ rotation.mT + root_positions(groom, posed.vertices, body)[:, :, None]
