"""Points of the body that the roots of a groom are fitted to: the scalp and, under a beard, the lower face."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from quaffure.body.body_model import BodyModel
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.types import Tensor

TARGET_ROWS = 40


@dataclass(frozen=True)
class ScalpTarget:
    """Evenly distributed points of the scalp to align roots with.

    Attributes:
        points: on the scalp [m], then on the lower face where there are such.
        normals: unit, outwards.
        rim: whether a point lies at the hairline, beyond which there is no hair.
        face: whether a point is on the lower face: roots may be there, and need not.
    """

    points: Float[np.ndarray, "t 3"]
    normals: Float[np.ndarray, "t 3"]
    rim: Bool[np.ndarray, " t"]
    face: Bool[np.ndarray, " t"]

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    @cached_property
    def scalp_points(self) -> Float[np.ndarray, "p 3"]:
        """The points that hair must cover."""
        return self.points[~self.face]

    def thinned(self, count: int) -> "ScalpTarget":
        """Every k-th point, so that about `count` are left."""
        kept = np.arange(0, len(self.points), max(1, len(self.points) // count))
        return ScalpTarget(self.points[kept], self.normals[kept], self.rim[kept], self.face[kept])


@lru_cache(maxsize=4)
def scalp_target(body: BodyModel) -> ScalpTarget:
    """Points of the scalp on a grid of its chart; those with a neighbour off the scalp are the rim."""
    centre = (torch.arange(TARGET_ROWS) + 0.5) / TARGET_ROWS
    v, u = torch.meshgrid(centre, centre, indexing="ij")
    faces, barycentric = body.scalp.locate(torch.stack([u, v], dim=-1).reshape(-1, 2))
    on = (faces >= 0).reshape(TARGET_ROWS, TARGET_ROWS)
    padded = torch.nn.functional.pad(on, (1, 1, 1, 1))
    surrounded = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    kept = on.flatten()
    corners = body.faces[faces[kept]]
    points = (barycentric[kept][..., None] * body.rest_vertices[corners]).sum(-2)
    normals = (barycentric[kept][..., None] * _vertex_normals(body)[corners]).sum(-2)
    return ScalpTarget(
        points.double().numpy(),
        torch.nn.functional.normalize(normals, dim=-1).double().numpy(),
        (~surrounded).flatten()[kept].numpy(),
        np.zeros(len(points), dtype=bool),
    )


def with_lower_face(target: ScalpTarget, body: BodyModel) -> ScalpTarget:
    """The target with the skin where a beard grows: below and in front of the middle of the ears, above the neck."""
    scalp = torch.zeros(len(body.rest_vertices), dtype=torch.bool)
    scalp[body.faces[body.scalp.faces]] = True
    ear = body.rest_vertices[body.ear_vertices].mean(0)
    neck = body.rest_joints[body.joint_names.index("Neck")]
    _, y, z = body.rest_vertices.unbind(-1)
    lower_face = (z < ear[2]) & (z > neck[2]) & (y < ear[1]) & ~scalp
    return _joined(target, _vertices(body, lower_face, face=True))


def head_target(body: BodyModel, lowest: float) -> ScalpTarget:
    """The vertices of the body above a height [m], without rim."""
    return _vertices(body, body.rest_vertices[:, 2] > lowest, face=False)


def _vertices(body: BodyModel, chosen: Bool[Tensor, " v"], face: bool) -> ScalpTarget:
    points = body.rest_vertices[chosen].double().numpy()
    normals = _vertex_normals(body)[chosen].double().numpy()
    return ScalpTarget(points, normals, np.zeros(len(points), dtype=bool), np.full(len(points), face))


def _joined(first: ScalpTarget, second: ScalpTarget) -> ScalpTarget:
    return ScalpTarget(
        np.concatenate([first.points, second.points]),
        np.concatenate([first.normals, second.normals]),
        np.concatenate([first.rim, second.rim]),
        np.concatenate([first.face, second.face]),
    )


@lru_cache(maxsize=4)
def _vertex_normals(body: BodyModel) -> Float[Tensor, "v 3"]:
    normals = angle_weighted_vertex_normals(body.rest_vertices[None], body.faces)[0]
    return torch.nn.functional.normalize(normals, dim=-1)
