"""Poses and shapes of bodies as callers give them: as tensors, and refused where no body can have them."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from quaffure.errors import InputError, refused
from quaffure.types import Tensor

Rows = Tensor | np.ndarray | Sequence[Any]
"""Numbers in rows: a tensor, an array, or lists in a list."""
JOINT_COUNT, SHAPE_COUNT = 27, 10
LARGEST_ROTATION = 4 * math.pi
"""Limit of a joint's rotation [rad]. Continuous axis-angles pass 2 pi; float32 loses a rotation of 1e30 rad."""
LARGEST_COEFFICIENT = 10.0
"""Limit of a shape coefficient [standard deviations]; beyond it nothing human is left."""


def rows_of(values: Rows, size: int, like: Tensor, source: str) -> Tensor:
    """Numbers as a tensor [rows, size] of the type and on the device of another; the same tensor where it is one.

    Raises:
        InputError: not numbers, or of another shape.
    """
    expected = f"numbers [batch, {size}]"
    if not isinstance(values, Tensor):
        values = tensor_of(values, source, torch.float64)
    if values.ndim != 2 or values.shape[1] != size or values.is_complex():
        raise InputError(source, expected, f"{list(values.shape)}")
    return values.to(like)


def tensor_of(values: Rows, source: str, dtype: torch.dtype = torch.float32) -> Tensor:
    """Numbers of an array or of lists as a new tensor of this type; a tensor as it is.

    Raises:
        InputError: not numbers, or lists of different lengths.
    """
    if isinstance(values, Tensor):
        return values
    with refused(source, "numbers", TypeError, ValueError, OverflowError):
        # Through numpy, because torch reads a list of arrays element by element.
        array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise InputError(source, "numbers", f"{array.dtype}")
    # What float32 cannot hold becomes infinite, which the checks refuse.
    return torch.from_numpy(array.astype(np.float64)).to(dtype)


def shape_of(values: Rows, source: str = "body_shape") -> Tensor:
    """The coefficients beta [10] of one body, as `tensor_of` gives them.

    Raises:
        InputError: other numbers of them, or what `check_body_shape` refuses.
    """
    shape = tensor_of(values, source)
    if shape.shape != (SHAPE_COUNT,) or shape.is_complex():
        raise InputError(source, f"{SHAPE_COUNT} coefficients", f"{list(shape.shape)}")
    check_body_shape(shape, source)
    return shape


def check_body_pose(body_pose: Tensor, source: str) -> None:
    """Refuse poses theta [..., 81], three numbers a joint [rad], that are not finite or rotate beyond two revolutions.

    Raises:
        InputError: there is one.
    """
    angles = body_pose.detach().unflatten(-1, (-1, 3)).norm(dim=-1)
    if not bool((angles <= LARGEST_ROTATION).all()):
        if not bool(body_pose.isfinite().all()):
            raise InputError(source, "finite joint angles", "NaN or infinity")
        expected = f"rotations of at most {LARGEST_ROTATION:.4g} rad (4 pi)"
        raise InputError(source, expected, f"one of {float(angles.max()):.3g} rad")


def check_body_shape(body_shape: Tensor, source: str) -> None:
    """Refuse shape coefficients beta [..., 10] that are not finite or beyond what a body can have.

    Raises:
        InputError: there is one.
    """
    if not bool((body_shape.detach().abs() <= LARGEST_COEFFICIENT).all()):
        largest = float(body_shape.detach().abs().max())
        found = f"one of {largest:.3g}" if math.isfinite(largest) else "NaN or infinity"
        raise InputError(source, f"coefficients within +-{LARGEST_COEFFICIENT:g}", found)
