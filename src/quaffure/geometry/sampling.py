"""Points chosen so that they cover the others evenly, and points put in an order that keeps neighbours together."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor


def farthest_points(points: Float[np.ndarray, "p 3"], most: int) -> Int[np.ndarray, " m"]:
    """Indices of up to `most` points, each the farthest from those before it, in ascending order."""
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    distance[0] = -1.0  # two points may lie in one place, and still count as two
    while len(chosen) < min(most, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        distance[chosen] = -1.0
    return np.sort(chosen)


def spatial_order(points: Float[Tensor, "p d"], size: int) -> Int[Tensor, " p"]:
    """Order in which every `size` points are near each other: halved along their longest extent, over and over."""
    ordered, parts = [], [torch.arange(len(points), device=points.device)]
    while parts:
        part = parts.pop()
        if len(part) <= size:
            ordered.append(part)
            continue
        extent = points[part].amax(0) - points[part].amin(0)
        part = part[points[part, int(extent.argmax())].argsort(stable=True)]
        half = -(-len(part) // size) // 2 * size
        parts += [part[half:], part[:half]]
    return torch.cat(ordered)
