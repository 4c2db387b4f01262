"""Metrics of what a picture shows: whether hair hangs, floats above what should support it, or jumps between frames."""

import numpy as np
import torch
from numba import njit, prange

from quaffure.geometry.cell_list import cell_columns, check_finite, sort_into_cells
from quaffure.geometry.signed_distance import signed_distance
from quaffure.scene import HairScene
from quaffure.types import Bool, Float, Positions, Tensor

GAP = 8e-3
"""Hair farther than this from the skin and from the nearest hair below it is in the air [m]."""
JUMP_SPEED = 1.5
"""A tip jumps where it moves faster than this from a frame to the next, beyond its root and its posed tip [m/s]: 5 cm
in a frame at 30 per second."""


def off_vertical(draped: Positions) -> Float[Tensor, " b"]:
    """Median angle of the outer edges to gravity [deg]: 12 to 22 of 23. The inner half follows the head, the last edge
    may curl."""
    edges = draped.shape[2] - 1
    direction = torch.nn.functional.normalize(draped.diff(dim=2)[:, :, edges // 2 : edges - 1], dim=-1)
    angle = torch.rad2deg(torch.arccos((-direction[..., 2]).clamp(-1, 1)))
    return angle.flatten(1).median(dim=1).values


def in_the_air(draped: Positions, scene: HairScene) -> Bool[Tensor, "b s m"]:
    """Which vertices, roots left out, neither the skin nor hair carries.

    They are farther than `GAP` from the skin, and have no vertex of another strand that is nearer to it within `GAP`.

    Raises:
        ValueError: a coordinate is not finite.
    """
    check_finite(draped)
    distance = signed_distance(draped.flatten(1, 2), scene.surface).reshape(draped.shape[:3])
    found = torch.empty_like(distance, dtype=torch.bool)
    for sample in range(len(draped)):
        points = draped[sample].reshape(-1, 3).detach().numpy()
        order, start, shape = sort_into_cells(points, np.float32(GAP))
        above = distance[sample].flatten().detach().numpy()
        supported = np.zeros(len(points), np.bool_)
        _mark_supported(points[order], above[order], order // draped.shape[2], start, shape, supported)
        lone = np.empty_like(supported)
        lone[order] = ~supported
        found[sample] = torch.from_numpy(lone).view(draped.shape[1:3])
    return (found & (distance > GAP))[:, :, 1:]


@njit(cache=True, parallel=True)
def _mark_supported(
    points: np.ndarray, distance: np.ndarray, strand: np.ndarray, start: np.ndarray, shape: tuple[int, int, int],
    supported: np.ndarray,
) -> None:  # fmt: skip
    """Mark the points that have one of another strand within `GAP` which is nearer to the skin. Points are sorted into
    cells of that side."""
    for cell in prange(len(start) - 1):
        ranges = np.empty((9, 2), np.int64)
        columns = cell_columns(cell, shape, start, ranges) if start[cell] < start[cell + 1] else 0
        for row in range(start[cell], start[cell + 1]):
            for column in range(columns):
                for other in range(ranges[column, 0], ranges[column, 1]):
                    if supported[row] or strand[other] == strand[row] or distance[other] >= distance[row]:
                        continue
                    offset = points[other] - points[row]
                    supported[row] = (offset * offset).sum() < GAP * GAP


def jumps(draped: Positions, posed: Positions) -> Float[Tensor, "f s"]:
    """How far every tip moves from each frame to the next, beyond what its root and its posed tip move [m].

    Args:
        draped, posed: of consecutive frames [m, world].
    """
    tip, root, posed_tip = (
        hair.diff(dim=0).norm(dim=-1) for hair in (draped[:, :, -1], draped[:, :, 0], posed[:, :, -1])
    )
    return (tip - torch.maximum(root, posed_tip)).clamp(min=0)


def velocity_changes(tips: Float[Tensor, "f s 3"]) -> Float[Tensor, "f-2 s"]:
    """How much the displacement of every tip changes from a frame to the next [m]: large where hair trembles.

    Args:
        tips: of consecutive frames [m, world].
    """
    return tips.diff(n=2, dim=0).norm(dim=-1)
