"""Nearest faces in torch, for any device: faces in leaves of neighbours, most of which their boxes rule out.

Twins that compare every point with every face are `quaffure.geometry.triangle_grid_reference` and
`quaffure.geometry.signed_distance.closest_points_reference`; on the CPU compiled kernels are faster.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch

from quaffure.geometry.triangle_grid import EDGE_TOLERANCE, NONE
from quaffure.geometry.triangle_grid_reference import band_key
from quaffure.types import Float, Int, Tensor

LEAF = 32
"""Faces of a leaf."""
_PAIRS = 16_000_000  # pairs of a point and a leaf that are compared at once


class TriangleLeaves(NamedTuple):
    """Posed faces in leaves; the last leaf repeats the last face.

    Attributes:
        faces: index of each face.
        corners: positions [m].
        low, high: corners of the leaves' boxes [m].
    """

    faces: Int[Tensor, "leaf 32"]
    corners: Float[Tensor, "leaf 32 3 3"]
    low: Float[Tensor, "leaf 3"]
    high: Float[Tensor, "leaf 3"]


def triangle_leaves(corners: Float[Tensor, "k 3 3"], order: Int[Tensor, " k"]) -> TriangleLeaves:
    """Leaves of faces, neighbours next to each other in `order`."""
    faces = torch.cat([order, order[-1:].expand(-len(order) % LEAF)]).view(-1, LEAF)
    posed = corners[faces]
    return TriangleLeaves(faces, posed, posed.amin(dim=(1, 2)), posed.amax(dim=(1, 2)))


def nearest_in_band(
    points: Float[Tensor, "p 3"], corners: Float[Tensor, "k 3 3"], leaves: TriangleLeaves, band: Float[Tensor, "k 2"]
) -> tuple[Float[Tensor, " p"], Int[Tensor, " p"]]:
    """As `nearest_triangle_in_band_reference`.

    Args:
        corners: of the faces, posed [m].
        leaves: of the same.
        band: how far below and above each face it counts for points [m].
    """
    of_leaf = band[leaves.faces]
    reach = of_leaf.amax(dim=(1, 2))[:, None] + EDGE_TOLERANCE
    low, high = leaves.low - reach, leaves.high + reach
    near = ((points[:, None] >= low) & (points[:, None] <= high)).all(-1)

    def compare(point: Int[Tensor, " m"], leaf: Int[Tensor, " m"]) -> Float[Tensor, "m 32"]:
        return band_key(points[point][:, None], leaves.corners[leaf], of_leaf[leaf])[0]

    nearest = _nearest_of_pairs(near, leaves, compare, beyond=1.0)
    some = nearest.clamp(min=0)
    _, height = band_key(points, corners[some], band[some])
    return torch.where(nearest >= 0, height, 1), nearest


def nearest_triangles(
    points: Float[Tensor, "p 3"],
    leaves: TriangleLeaves,
    squared_distance: Callable[[Float[Tensor, "m 1 3"], Float[Tensor, "m 32 3 3"]], Float[Tensor, "m 32"]],
) -> Int[Tensor, " p"]:
    """The nearest face of each point.

    Args:
        squared_distance: of points from triangles [m^2].
    """
    found = []
    for part in points.split(max(1, _PAIRS // len(leaves.low))):
        gap = torch.maximum(leaves.low - part[:, None], part[:, None] - leaves.high).clamp(min=0).square().sum(-1)
        # Some corner of a leaf is no nearer than its nearest face.
        bound = (part[:, None] - leaves.corners[:, 0, 0]).square().sum(-1).amin(dim=1, keepdim=True)

        def compare(point: Int[Tensor, " m"], leaf: Int[Tensor, " m"], part: Tensor = part) -> Float[Tensor, "m 32"]:
            return squared_distance(part[point][:, None], leaves.corners[leaf])

        found.append(_nearest_of_pairs(gap <= bound * (1 + 1e-5) + 1e-12, leaves, compare, beyond=torch.inf))
    return torch.cat(found)


def _nearest_of_pairs(
    near: Tensor,
    leaves: TriangleLeaves,
    compare: Callable[[Int[Tensor, " m"], Int[Tensor, " m"]], Float[Tensor, "m 32"]],
    beyond: float,
) -> Int[Tensor, " p"]:
    """The face with the least key over the leaves near each point, of equal ones the first; `NONE` without any below
    `beyond`."""
    point, leaf = near.nonzero(as_tuple=True)
    key, count = compare(point, leaf), len(near)
    least = key.new_full((count,), beyond).scatter_reduce(0, point, key.amin(dim=1), "amin")
    none = int(leaves.faces.max()) + 1
    is_least = (key == least[point][:, None]) & (key < beyond)
    faces = torch.where(is_least, leaves.faces[leaf], none).amin(dim=1)
    nearest = torch.full((count,), none, device=key.device).scatter_reduce(0, point, faces, "amin")
    return torch.where(nearest < none, nearest, NONE)
