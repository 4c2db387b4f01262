"""Axes of files: the nearest to a direction, and its name; scale of their transforms."""

import numpy as np
from jaxtyping import Float


def nearest_axis(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Unit vector along the axis, of either sign, nearest to a direction."""
    largest = int(np.abs(direction).argmax())
    return np.sign(direction[largest]) * np.eye(3)[largest]


def axis_name(direction: Float[np.ndarray, "3"]) -> str:
    """The axis nearest to a direction, as in "+y"."""
    largest = int(np.abs(direction).argmax())
    return f"{'-+'[int(direction[largest] > 0)]}{'xyz'[largest]}"


def mean_scale(matrix: Float[np.ndarray, "3 3"]) -> float:
    """Factor by which a linear map scales lengths in the mean: the cube root of that of volumes."""
    return float(abs(np.linalg.det(matrix)) ** (1 / 3))
