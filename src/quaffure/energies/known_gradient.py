"""Energies of compiled kernels in autograd: the gradient comes with the value."""

import torch
from torch.autograd.function import FunctionCtx

from quaffure.types import Energy, Positions, Tensor


def with_gradient(positions: Positions, energy: Energy, gradient: Positions) -> Energy:
    """The energy of every sample [J], differentiable once, in the positions alone.

    Args:
        positions: vertices that the energy was computed of [m].
        gradient: its derivative by them [N].
    """
    return _KnownGradient.apply(positions, energy, gradient)  # type: ignore[no-untyped-call]


class _KnownGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, positions: Tensor, energy: Tensor, gradient: Tensor) -> Tensor:
        ctx.save_for_backward(gradient)
        return energy.clone()  # autograd would take an argument that is returned for the same tensor

    @staticmethod
    def backward(ctx: FunctionCtx, *upstream: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors  # type: ignore[attr-defined]
        return gradient * upstream[0][:, None, None, None], None, None
