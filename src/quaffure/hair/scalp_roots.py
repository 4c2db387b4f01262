"""Strand roots distributed evenly over the scalp, with smooth normals."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.body.scalp import texel_index
from quaffure.config import TEXTURE_SIZE
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.types import Float, Int, Tensor

# Largest random offset of a root, as a share of its cell.
JITTER = 0.35


@dataclass(frozen=True)
class ScalpRoots:
    """Roots of strands on the mean body at rest.

    Attributes:
        faces: body faces under the roots.
        barycentric: coordinates in those faces.
        uv: positions on the scalp chart.
        points: positions [m].
        normals: unit, outwards; of the scalp's triangles alone, without the ears.
        head: the body's Head joint, the origin of heights [m].
    """

    faces: Int[Tensor, " s"]
    barycentric: Float[Tensor, "s 3"]
    uv: Float[Tensor, "s 2"]
    points: Float[Tensor, "s 3"]
    normals: Float[Tensor, "s 3"]
    head: Float[Tensor, "3"]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def from_head(self) -> Float[Tensor, "s 3"]:
        """Positions relative to the Head joint [m]."""
        return self.points - self.head

    def select(self, strands: Int[Tensor, " m"]) -> "ScalpRoots":
        """Some of the roots, in the given order."""
        names = ("faces", "barycentric", "uv", "points", "normals")
        changes: dict[str, Any] = {name: getattr(self, name)[strands] for name in names}
        return replace(self, **changes)


def spread_roots(body: BodyModel, rows: int, generator: torch.Generator) -> ScalpRoots:
    """Roots on a jittered grid of `rows` x `rows` over the scalp chart.

    No two fall into one texel of the texture, as long as `rows` is at most its size.
    """
    centre = (torch.arange(rows) + 0.5) / rows
    v, u = torch.meshgrid(centre, centre, indexing="ij")
    even = torch.stack([u, v], dim=-1).reshape(-1, 2)
    even = even[body.scalp.locate(even)[0] >= 0]
    uv = even + JITTER / rows * (2 * torch.rand(even.shape, generator=generator) - 1)
    # Where the jitter leaves the scalp or shares a texel, it is undone.
    for _ in range(len(even)):
        _, texel, counts = torch.unique(texel_index(uv, TEXTURE_SIZE), return_inverse=True, return_counts=True)
        bad = ((body.scalp.locate(uv)[0] < 0) | (counts[texel] > 1)) & (uv != even).any(-1)
        if not bad.any():
            break
        uv = torch.where(bad[:, None], even, uv)
    return roots_at(body, uv)


def roots_at(body: BodyModel, uv: Float[Tensor, "s 2"]) -> ScalpRoots:
    """Roots at points of the scalp chart."""
    faces, barycentric = body.scalp.locate(uv)
    corners = body.faces[faces]
    points = (barycentric[..., None] * body.rest_vertices[corners]).sum(-2)
    own = angle_weighted_vertex_normals(body.rest_vertices[None], body.faces[body.scalp.faces])[0]
    normals = normalize((barycentric[..., None] * normalize(own, dim=-1)[corners]).sum(-2), dim=-1)
    head = body.rest_joints[body.joint_names.index("Head")]
    return ScalpRoots(faces, barycentric, body.scalp.uv_at(faces, barycentric), points, normals, head)
