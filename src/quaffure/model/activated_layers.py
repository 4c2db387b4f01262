"""A layer and its SiLU in one pass, with weights laid out in advance; without gradient.

torch keeps these operations of oneDNN for its own compiler (`torch.compile`) and does not document them. Where they are
missing or others, documented ones compute the same.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import torch
from torch.nn.functional import conv2d, conv_transpose2d, linear, silu

from quaffure.types import Float, Tensor

_SILU: tuple[str, list[float], str] = ("swish", [], "")  # what is done to the sums, its numbers, its variant
_ONE = [1, 1]


class ActivatedLayer(NamedTuple):
    """A layer that can be called.

    Attributes:
        weight, bias: as they were given, to be counted.
        run: from inputs to activations.
    """

    weight: Tensor
    bias: Tensor
    run: Callable[[Tensor], Tensor]

    def __call__(self, values: Tensor) -> Tensor:
        return self.run(values)


def activated_linear(weight: Float[Tensor, "out in"], bias: Tensor) -> ActivatedLayer:
    """SiLU of a linear layer."""
    if fused(weight.dtype):
        return _fused_linear(weight, bias)
    return ActivatedLayer(weight, bias, lambda values: silu(linear(values, weight, bias), inplace=True))


def activated_convolution(weight: Float[Tensor, "out in 3 3"], bias: Tensor) -> ActivatedLayer:
    """SiLU of a convolution that keeps the size of a channels-last texture."""
    if fused(weight.dtype):
        return _fused_convolution(weight, bias)
    return ActivatedLayer(weight, bias, lambda values: silu(conv2d(values, weight, bias, padding=1), inplace=True))


def activated_doubling(weight: Float[Tensor, "in out 4 4"], bias: Tensor) -> ActivatedLayer:
    """SiLU of a transposed convolution that doubles the size of a channels-last texture."""
    if fused(weight.dtype):
        return _fused_doubling(weight, bias)
    return ActivatedLayer(
        weight, bias, lambda values: silu(conv_transpose2d(values, weight, bias, stride=2, padding=1), inplace=True)
    )


@cache
def fused(dtype: torch.dtype) -> bool:
    """Whether layers of this precision run as one operation here: tried on a layer of each kind."""
    bias, texture = torch.zeros(8, dtype=dtype), torch.zeros(1, 8, 4, 4, dtype=dtype)
    texture = texture.contiguous(memory_format=torch.channels_last)
    try:
        _fused_linear(torch.zeros(8, 8, dtype=dtype), bias)(texture[:, :, 0, 0].contiguous())
        _fused_convolution(torch.zeros(8, 8, 3, 3, dtype=dtype), bias)(texture)
        _fused_doubling(torch.zeros(8, 8, 4, 4, dtype=dtype), bias)(texture)
    except (AttributeError, RuntimeError, TypeError):
        return False
    return True


def _fused_linear(weight: Tensor, bias: Tensor) -> ActivatedLayer:
    ops = torch.ops.mkldnn
    packed = ops._reorder_linear_weight(weight)
    return ActivatedLayer(weight, bias, lambda values: ops._linear_pointwise(values, packed, bias, *_SILU))


def _fused_convolution(weight: Tensor, bias: Tensor) -> ActivatedLayer:
    ops, geometry = torch.ops.mkldnn, (_ONE, _ONE, _ONE, 1)  # padding, stride, dilation, groups
    packed = ops._reorder_convolution_weight(weight, *geometry)
    return ActivatedLayer(
        weight, bias, lambda values: ops._convolution_pointwise(values, packed, bias, *geometry, *_SILU)
    )


def _fused_doubling(weight: Tensor, bias: Tensor) -> ActivatedLayer:
    ops, geometry = torch.ops.mkldnn, (_ONE, [0, 0], [2, 2], _ONE, 1)  # padding, more of it, stride, dilation, groups
    packed = ops._reorder_convolution_transpose_weight(weight, *geometry)
    return ActivatedLayer(
        weight, bias, lambda values: ops._convolution_transpose_pointwise(values, packed, bias, *geometry, *_SILU)
    )
