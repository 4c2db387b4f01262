"""Signed distance to a closed surface: the search finds integers and weights, the formula is plain torch.

Distance is positive outside. `closest_points` is compiled and exact on the CPU; `closest_points_reference` is its torch
twin.
"""

from dataclasses import dataclass

import numpy as np
import torch

from quaffure.geometry.bvh import search_all
from quaffure.geometry.surface import Surface, bvh_of, reference_surface_normals
from quaffure.geometry.triangle_leaves import nearest_triangles, triangle_leaves
from quaffure.types import Float, Int, Tensor

_REFERENCE_PAIRS = 4_000_000  # point-face pairs that the twin holds in memory at once


@dataclass(frozen=True)
class ClosestPoints:
    """The nearest point of the surface to each of a set of points. No gradient flows through any of it.

    Attributes:
        faces: the nearest face, an index into the mesh's faces.
        barycentric: weights of that face's corners.
        normals: pseudonormal of the nearest feature (face, edge or vertex), outwards, not unit.
    """

    faces: Int[Tensor, "b p"]
    barycentric: Float[Tensor, "b p 3"]
    normals: Float[Tensor, "b p 3"]


def closest_points(points: Float[Tensor, "b p 3"], surface: Surface) -> ClosestPoints:
    """Closest points to `points` [m] on the same sample's surface. Compiled search on the CPU, torch elsewhere."""
    if points.device.type != "cpu":
        return closest_points_by_leaves(points, surface)
    samples = []
    for sample, of_sample in enumerate(points.detach()):
        array = np.ascontiguousarray(of_sample.numpy(), dtype=np.float32)
        arrays = surface.sample_arrays(sample)
        leaves = search_all(array, arrays.corners, bvh_of.py_func(arrays))
        faces = torch.from_numpy(surface.topology.face_order[leaves]).long()
        triangles = surface.vertices[sample].detach().to(points)[surface.topology.faces[faces]]
        barycentric, feature = closest_barycentric(of_sample, triangles)
        normals = torch.from_numpy(arrays.normals[leaves, feature.numpy()]).to(points)
        samples.append((faces, barycentric, normals))
    return ClosestPoints(*(torch.stack(field) for field in zip(*samples)))


def closest_points_by_leaves(points: Float[Tensor, "b p 3"], surface: Surface) -> ClosestPoints:
    """As `closest_points_reference`, without the faces of leaves that are too far away."""
    triangles = surface.vertices.detach()[:, surface.topology.faces].to(points)
    normals = reference_surface_normals(surface.topology, surface.vertices.detach()).to(points)
    order = torch.from_numpy(surface.topology.face_order).to(triangles.device).long()
    samples = []
    for own, corners, at_feet in zip(points.detach(), triangles, normals):
        nearest = nearest_triangles(own, triangle_leaves(corners, order), _squared_distances)
        barycentric, feature = closest_barycentric(own, corners[nearest])
        samples.append((nearest, barycentric, at_feet[nearest, feature]))
    return ClosestPoints(*(torch.stack(field) for field in zip(*samples)))


def _squared_distances(points: Float[Tensor, "*#n 3"], triangles: Float[Tensor, "*#n 3 3"]) -> Float[Tensor, "*n"]:
    barycentric, _ = closest_barycentric(points, triangles)
    return (points - (barycentric[..., None] * triangles).sum(-2)).square().sum(-1)


def closest_points_reference(points: Float[Tensor, "b p 3"], surface: Surface) -> ClosestPoints:
    """Torch twin of `closest_points`: every point against every face, in chunks."""
    triangles = surface.vertices.detach()[:, surface.topology.faces].to(points)
    normals = reference_surface_normals(surface.topology, surface.vertices.detach()).to(points)
    chunk = max(1, _REFERENCE_PAIRS // triangles.shape[1])
    samples = [
        [_nearest_of_all(part, triangles[sample], normals[sample]) for part in points[sample].detach().split(chunk)]
        for sample in range(len(points))
    ]
    faces, barycentric, at_feet = (
        torch.stack([torch.cat([part[field] for part in parts]) for parts in samples]) for field in range(3)
    )
    return ClosestPoints(faces, barycentric, at_feet)


def _nearest_of_all(
    points: Float[Tensor, "p 3"], triangles: Float[Tensor, "k 3 3"], normals: Float[Tensor, "k 7 3"]
) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 3"], Float[Tensor, "p 3"]]:
    barycentric, feature = closest_barycentric(points[:, None], triangles[None])
    nearest = _squared_distances(points[:, None], triangles[None]).argmin(dim=1)
    rows = torch.arange(len(points), device=points.device)
    return nearest, barycentric[rows, nearest], normals[nearest, feature[rows, nearest]]


def closest_barycentric(
    points: Float[Tensor, "*#n 3"], triangles: Float[Tensor, "*#n 3 3"]
) -> tuple[Float[Tensor, "*n 3"], Int[Tensor, "*n"]]:
    """Barycentric weights of the closest point of a triangle, and its feature as in `closest_on_triangle`.

    By comparing the foot on the plane, where it is inside, with the feet on the three edges: slower than traversing the
    Voronoi regions, and independent of it.
    """
    first, second, third = triangles.unbind(-2)
    normal = torch.linalg.cross(second - first, third - first)
    area = normal.square().sum(-1).clamp(min=1e-30)
    inside = torch.stack(
        [
            (torch.linalg.cross(end - start, points - start) * normal).sum(-1) / area
            for start, end in ((second, third), (third, first), (first, second))
        ],
        dim=-1,
    )
    candidates = [inside]
    # A face without area has no plane: its weights do not add up, and its edges count alone.
    features = [torch.where((inside >= 0).all(-1) & ((inside.sum(-1) - 1).abs() < 1e-3), 0, -1)]
    for edge in range(3):
        start, end = triangles[..., edge, :], triangles[..., (edge + 1) % 3, :]
        along = end - start
        t = (((points - start) * along).sum(-1) / along.square().sum(-1).clamp(min=1e-30)).clamp(0, 1)
        weights = torch.zeros_like(inside)
        weights[..., edge] = 1 - t
        weights[..., (edge + 1) % 3] = t
        candidates.append(weights)
        corner = torch.where(t <= 0, 4 + edge, 4 + (edge + 1) % 3)
        features.append(torch.where((t > 0) & (t < 1), 1 + edge, corner))
    weights = torch.stack(candidates)
    feature = torch.stack(features)
    squared = (points - (weights[..., None] * triangles).sum(-2)).square().sum(-1)
    choice = squared.masked_fill(feature < 0, float("inf")).argmin(dim=0, keepdim=True)
    return weights.gather(0, choice[..., None].expand(1, *inside.shape))[0], feature.gather(0, choice)[0]


def signed_distance(points: Float[Tensor, "b p 3"], surface: Surface) -> Float[Tensor, "b p"]:
    """Exact distance to the surface [m], positive outside, differentiable in `points` and the surface's vertices.

    The gradient holds the foot point's weights fixed, which is exact to first order (envelope theorem); at distance
    zero, where the norm has no gradient, it is the feature's normal.
    """
    offset, direction = surface_offsets(points, surface)
    return (offset * direction).sum(-1)


def surface_offsets(
    points: Float[Tensor, "b p 3"], surface: Surface
) -> tuple[Float[Tensor, "b p 3"], Float[Tensor, "b p 3"]]:
    """Offset of points from the closest points of the surface [m], and the unit direction away from it on its outside.

    The offset is differentiable in the points and the surface's vertices; the direction has no gradient.
    """
    foot = closest_points(points, surface)
    corners, vertices = surface.topology.faces[foot.faces], surface.vertices.to(points)
    nearest = torch.stack([vertices[sample, corners[sample]] for sample in range(len(points))])
    offset = points - (foot.barycentric[..., None] * nearest).sum(-2)
    with torch.no_grad():
        sign = torch.where((offset * foot.normals).sum(-1) < 0, -1.0, 1.0)[..., None]
        length = offset.norm(dim=-1, keepdim=True)
        outward = torch.nn.functional.normalize(foot.normals, dim=-1)
        # Shorter offsets are rounding, which has no direction.
        return offset, torch.where(length > 1e-6, sign * offset / length.clamp(min=1e-9), outward)
