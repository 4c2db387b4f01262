"""Normals of triangle meshes.

Faces are counter-clockwise seen from outside, so that normals point outwards.
"""

import torch
from torch.nn.functional import normalize

from quaffure.types import Float, Int, MeshFaces, MeshVertices, Tensor


def face_normals(triangles: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 3"]:
    """Unit outward normals."""
    first, second, third = triangles.unbind(-2)
    return normalize(torch.linalg.cross(second - first, third - first), dim=-1)


def angle_weighted_vertex_normals(vertices: MeshVertices, faces: MeshFaces) -> Float[Tensor, "b v 3"]:
    """Sum of the normals of a vertex's faces weighted by their angle there (Baerentzen and Aanaes 2005), not unit.

    The sign of a point whose nearest feature is that vertex is the sign of its offset along this normal, exactly.
    """
    triangles = vertices[:, faces]
    forward, backward = triangles.roll(-1, dims=-2) - triangles, triangles.roll(1, dims=-2) - triangles
    sine = torch.linalg.cross(forward, backward).norm(dim=-1)
    angle = torch.atan2(sine, (forward * backward).sum(-1))
    weighted = face_normals(triangles)[..., None, :] * angle[..., None]
    return torch.zeros_like(vertices).index_add(1, faces.flatten(), weighted.flatten(1, 2))


def opposite_faces(faces: MeshFaces) -> Int[Tensor, "k 3"]:
    """The face across each edge; edge e of a face runs from its corner e to corner e + 1.

    Raises:
        ValueError: the mesh is not closed or not consistently oriented.
    """
    start, end = faces, faces.roll(-1, dims=1)
    count = int(faces.max()) + 1
    forward, backward = (start * count + end).flatten(), (end * count + start).flatten()
    order = forward.argsort()
    position = torch.searchsorted(forward[order], backward).clamp(max=len(order) - 1)
    twin = order[position]
    if forward.unique().numel() != forward.numel() or not torch.equal(forward[twin], backward):
        raise ValueError("expected a closed mesh in which two oppositely directed faces share every edge")
    return (twin // 3).reshape(-1, 3)
