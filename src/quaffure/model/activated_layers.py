"""A layer and its SiLU in one pass, with weights laid out in advance; without gradient.

torch keeps these operations of oneDNN for its own compiler (`torch.compile`) and does not document them. Where they are
missing or others, documented ones compute the same.

Layers give the same bits with any number of threads as far as oneDNN does: tests try it on the shipped network.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import torch
from torch.nn.functional import conv2d, linear, silu

from quaffure.types import Float, Tensor

# What is done to the sums, its numbers, its variant: names of oneDNN's arguments.
_SILU: dict[str, Any] = {"attr": "swish", "scalars": [], "algorithm": ""}
_NONE: dict[str, Any] = {"attr": "none", "scalars": [], "algorithm": ""}
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


def activated_convolution(weight: Float[Tensor, "out in k k"], bias: Tensor) -> ActivatedLayer:
    """SiLU of a convolution, padding 1, of a channels-last texture."""
    if fused(weight.dtype):
        return _fused_convolution(weight, bias)
    return ActivatedLayer(weight, bias, lambda values: silu(conv2d(values, weight, bias, padding=1), inplace=True))


def activated_doubling(weight: Float[Tensor, "in out 4 4"], bias: Tensor) -> ActivatedLayer:
    """SiLU of a transposed convolution (stride 2, padding 1) that doubles the size of a channels-last texture.

    It is computed as one convolution that is given all four texels of a block at once: the last bits of oneDNN's
    transposed convolution depend on the number of threads.
    """
    blocks = activated_convolution(_block_kernel(weight), bias.repeat(4))
    channels = weight.shape[1]

    def run(values: Float[Tensor, "b in side side"]) -> Float[Tensor, "b out double double"]:
        windows, side = blocks.run(values).permute(0, 2, 3, 1), values.shape[2]
        doubled = values.new_empty(len(values), side, 2, side, 2, channels)
        for texel in range(4):
            row, column = divmod(texel, 2)
            own = windows[..., texel * channels : (texel + 1) * channels]
            doubled[:, :, row, :, column] = own[:, row : row + side, column : column + side]
        return doubled.flatten(1, 2).flatten(2, 3).permute(0, 3, 1, 2)

    return ActivatedLayer(weight, bias, run)


def plain_linear(weight: Float[Tensor, "out in"], bias: Tensor) -> ActivatedLayer:
    """A linear layer without activation, by oneDNN where it can be: the last bits of MKL's depend on the threads."""
    if fused(weight.dtype):
        return _fused_linear(weight, bias, _NONE)
    return ActivatedLayer(weight, bias, lambda values: linear(values, weight, bias))


def _block_kernel(weight: Float[Tensor, "in out 4 4"]) -> Float[Tensor, "four_out in 2 2"]:
    """Weights of the convolution, padding 1, whose window before a texel's corner holds what the block needs.

    A texel (a, b) of the block at (y, x) of the transposed convolution reads the window at (y + a, x + b); its taps are
    3 - a and 1 - a in rows, and likewise in columns.
    """
    parts = [weight[:, :, [3 - a, 1 - a]][..., [3 - b, 1 - b]] for a in (0, 1) for b in (0, 1)]
    return torch.cat([part.transpose(0, 1) for part in parts]).contiguous(memory_format=torch.channels_last)


@cache
def fused(dtype: torch.dtype) -> bool:
    """Whether layers of this precision run as one operation here: tried on a layer of each kind."""
    bias, texture = torch.zeros(8, dtype=dtype), torch.zeros(1, 8, 4, 4, dtype=dtype)
    texture = texture.contiguous(memory_format=torch.channels_last)
    try:
        _fused_linear(torch.zeros(8, 8, dtype=dtype), bias)(texture[:, :, 0, 0].contiguous())
        _fused_convolution(torch.zeros(8, 8, 3, 3, dtype=dtype), bias)(texture)
    except (AttributeError, RuntimeError, TypeError):
        return False
    return True


def _fused_linear(weight: Tensor, bias: Tensor, activation: dict[str, Any] = _SILU) -> ActivatedLayer:
    ops = torch.ops.mkldnn
    packed = ops._reorder_linear_weight(weight)
    return ActivatedLayer(weight, bias, partial(ops._linear_pointwise, W=packed, B=bias, **activation))


def _fused_convolution(weight: Tensor, bias: Tensor) -> ActivatedLayer:
    ops, geometry = torch.ops.mkldnn, {"padding": _ONE, "stride": _ONE, "dilation": _ONE, "groups": 1}
    packed = ops._reorder_convolution_weight(weight, *geometry.values())
    run = partial(ops._convolution_pointwise, W=packed, B=bias, **geometry, **_SILU)
    return ActivatedLayer(weight, bias, run)
