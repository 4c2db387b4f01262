"""Points chosen so that they cover the others evenly."""

import numpy as np
from jaxtyping import Float, Int


def spread_subset(points: Float[np.ndarray, "p 3"], most: int) -> Int[np.ndarray, " m"]:
    """Indices of up to `most` points, each the farthest from those before it, in ascending order."""
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    distance[0] = -1.0  # two points may lie in one place, and still count as two
    while len(chosen) < min(most, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        distance[chosen] = -1.0
    return np.sort(chosen)
