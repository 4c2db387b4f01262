"""Which implementation computes: the one place that reads a device or a number type."""

from enum import Enum

import torch
from torch import Tensor


class Backend(Enum):
    """What drapes, energies and solvers run on. Choose one in a constructor and keep it."""

    CPU = "cpu"
    """Compiled kernels, float32, on the CPU. Derivatives in the hair's positions alone."""
    TORCH = "torch"
    """torch operations on any device, in any floating type, differentiable in poses, shapes, positions and
    stiffness, and, with terms of your own, in the material."""


def choose_backend(values: Tensor) -> Backend:
    """`Backend.CPU` where the compiled kernels can read `values`, `Backend.TORCH` elsewhere."""
    compiled = values.device.type == "cpu" and values.dtype == torch.float32
    return Backend.CPU if compiled else Backend.TORCH
