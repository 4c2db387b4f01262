"""Where strands grow from: roots spread evenly over the scalp, and the smooth normals under them."""

from dataclasses import dataclass

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.config import TEXTURE_SIZE
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.types import Float, Int, Tensor

# Roots stay this share of a cell clear of its border.
JITTER = 0.35


@dataclass(frozen=True)
class ScalpRoots:
    """Roots of strands on the mean body at rest.

    Attributes:
        faces: body faces that carry them.
        barycentric: where in those faces.
        uv: where on the scalp chart.
        points: positions [m].
        normals: unit, outwards; the scalp's own, the ears beside it do not bend them.
        head: the body's Head joint, from which heights are counted [m].
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
        """Positions seen from the Head joint [m]."""
        return self.points - self.head

    def select(self, strands: Int[Tensor, " m"]) -> "ScalpRoots":
        """Some of the roots, in the order given."""
        return ScalpRoots(
            self.faces[strands],
            self.barycentric[strands],
            self.uv[strands],
            self.points[strands],
            self.normals[strands],
            self.head,
        )


def spread_roots(body: BodyModel, rows: int, generator: torch.Generator) -> ScalpRoots:
    """Roots on a jittered grid of `rows` x `rows` over the scalp chart.

    No two fall into one texel of the texture, as long as `rows` is at most its size.
    """
    centre = (torch.arange(rows) + 0.5) / rows
    v, u = torch.meshgrid(centre, centre, indexing="ij")
    even = torch.stack([u, v], dim=-1).reshape(-1, 2)
    even = even[body.scalp.locate(even)[0] >= 0]
    uv = even + JITTER / rows * (2 * torch.rand(even.shape, generator=generator) - 1)
    # Where the jitter leaves the scalp or crowds a texel, it is taken back.
    for _ in range(len(even)):
        row, column = body.scalp.texels(uv, TEXTURE_SIZE).unbind(-1)
        texel, visits = torch.unique(row * TEXTURE_SIZE + column, return_inverse=True)
        crowded = torch.bincount(visits, minlength=len(texel))[visits] > 1
        bad = ((body.scalp.locate(uv)[0] < 0) | crowded) & (uv != even).any(-1)
        if not bad.any():
            break
        uv = torch.where(bad[:, None], even, uv)
    return roots_at(body, uv)


def roots_at(body: BodyModel, uv: Float[Tensor, "s 2"]) -> ScalpRoots:
    """Roots at places of the scalp chart."""
    faces, barycentric = body.scalp.locate(uv)
    corners = body.faces[faces]
    points = (barycentric[..., None] * body.rest_vertices[corners]).sum(-2)
    own = angle_weighted_vertex_normals(body.rest_vertices[None], body.faces[body.scalp.faces])[0]
    normals = normalize((barycentric[..., None] * normalize(own, dim=-1)[corners]).sum(-2), dim=-1)
    head = body.rest_joints[body.joint_names.index("Head")]
    return ScalpRoots(faces, barycentric, body.scalp.uv_at(faces, barycentric), points, normals, head)
