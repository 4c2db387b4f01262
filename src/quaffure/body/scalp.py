"""The scalp chart: the part of the body with hair, parameterized over the unit square.

`u` runs from the body's right (0) to its left (1), `v` from the forehead (0) to the nape (1); the chart is the
mirror image of itself about u = 1/2. Texel (row, column) of a texture of size T covers v in [row, row + 1] / T
and u in [column, column + 1] / T.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

# Cells per side of the grid that lists candidate triangles of a point; a scalp triangle is about one cell wide.
CELLS = 48
# Barycentric tolerance: a point on a shared edge belongs to at least one of its triangles.
EDGE_SLACK = 1e-5


@dataclass(frozen=True)
class ScalpChart:
    """A disc-shaped part of the body surface with texture coordinates, injective.

    Attributes:
        faces: the scalp's triangles, as indices of body faces.
        uv: texture coordinates of each scalp triangle's corners, in the unit square.
    """

    faces: Int[Tensor, " f"]
    uv: Float[Tensor, "f 3 2"]

    def to(self, device: torch.device | str) -> "ScalpChart":
        return ScalpChart(self.faces.to(device), self.uv.to(device))

    def locate(self, uv: Float[Tensor, "p 2"]) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 3"]]:
        """The body face of each point and its barycentric coordinates; face -1 and zeros off the chart."""
        cell = (uv * CELLS).long()
        inside = ((uv >= 0) & (uv <= 1)).all(-1)
        column, row = cell.clamp(0, CELLS - 1).unbind(-1)
        candidates = self._cell_triangles[row * CELLS + column]
        barycentric = _barycentric(uv[:, None], self.uv[candidates])
        # The candidate with the largest minimal coordinate; padding repeats a real triangle.
        depth, best = barycentric.amin(-1).max(-1)
        rows = torch.arange(len(uv), device=uv.device)
        found = inside & (depth >= -EDGE_SLACK)
        weights = barycentric[rows, best].clamp(min=0)
        weights = weights / weights.sum(-1, keepdim=True).clamp(min=EDGE_SLACK)
        face = torch.where(found, self.faces[candidates[rows, best]], torch.full_like(best, -1))
        return face, torch.where(found[:, None], weights, torch.zeros_like(weights))

    def uv_at(self, body_face: Int[Tensor, " p"], barycentric: Float[Tensor, "p 3"]) -> Float[Tensor, "p 2"]:
        """Texture coordinates of points on scalp triangles, given by body face and barycentric coordinates.

        Raises:
            ValueError: a face is not part of the scalp.
        """
        order = torch.argsort(self.faces)
        found = torch.searchsorted(self.faces[order], body_face).clamp(max=len(order) - 1)
        triangle = order[found]
        if not torch.equal(self.faces[triangle], body_face):
            outside = int((self.faces[triangle] != body_face).sum())
            raise ValueError(f"expected faces of the scalp, found {outside} of {len(body_face)} off it")
        return (barycentric[..., None] * self.uv[triangle]).sum(-2)

    @cached_property
    def _cell_triangles(self) -> Int[Tensor, "cell candidate"]:
        """Scalp triangles whose bounding box meets each cell, rows padded with their first or with triangle 0."""
        low = (self.uv.amin(1) * CELLS - 1e-3).floor().long().clamp(0, CELLS - 1).tolist()
        high = (self.uv.amax(1) * CELLS + 1e-3).floor().long().clamp(0, CELLS - 1).tolist()
        cells: list[list[int]] = [[] for _ in range(CELLS * CELLS)]
        for triangle, ((left, top), (right, bottom)) in enumerate(zip(low, high)):
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    cells[row * CELLS + column].append(triangle)
        width = max(map(len, cells))
        padded = [cell + [cell[0] if cell else 0] * (width - len(cell)) for cell in cells]
        return torch.tensor(padded, dtype=torch.int64, device=self.uv.device)


def texel_index(uv: Float[Tensor, "p 2"], size: int) -> Int[Tensor, " p"]:
    """Flat index (row times size plus column) of the texel of each point; row from v, column from u."""
    cell = (uv * size).long().clamp(0, size - 1)
    return cell[:, 1] * size + cell[:, 0]


def _barycentric(point: Float[Tensor, "p 1 2"], triangle: Float[Tensor, "p c 3 2"]) -> Float[Tensor, "p c 3"]:
    first, second = triangle[..., 1, :] - triangle[..., 0, :], triangle[..., 2, :] - triangle[..., 0, :]
    offset = point - triangle[..., 0, :]
    area = _cross(first, second)
    weights = torch.stack([_cross(offset, second), _cross(first, offset)], dim=-1) / area[..., None]
    return torch.cat([1 - weights.sum(-1, keepdim=True), weights], dim=-1)


def _cross(a: Float[Tensor, "*batch 2"], b: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch"]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
