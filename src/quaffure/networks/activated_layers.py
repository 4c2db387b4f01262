"""A layer and its SiLU in one pass, with weights laid out in advance; without gradient.

torch keeps these operations of oneDNN for its own compiler (`torch.compile`) and does not document them. Where they are
missing, documented ones compute the same.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch.nn.functional import conv2d, conv_transpose2d, linear, silu

from quaffure.types import Float, Tensor

_NEEDED = (
    *("_linear_pointwise", "_convolution_pointwise", "_convolution_transpose_pointwise"),
    *("_reorder_linear_weight", "_reorder_convolution_weight", "_reorder_convolution_transpose_weight"),
)
_SILU: tuple[str, list[float], str] = ("swish", [], "")  # what is done to the sums, its numbers, its variant
_ONE = [1, 1]


class ActivatedLayer(NamedTuple):
    """A layer that can be called.

    Attributes:
        weight, bias: as they were given.
        run: from inputs to activations.
    """

    weight: Tensor
    bias: Tensor
    run: Callable[[Tensor], Tensor]

    def __call__(self, values: Tensor) -> Tensor:
        return self.run(values)


def fused(dtype: torch.dtype) -> bool:
    """Whether layers of this precision run as one operation here."""
    ops = torch.ops.mkldnn
    if not torch.backends.mkldnn.is_available() or not all(hasattr(ops, name) for name in _NEEDED):
        return False
    supported: bool = dtype == torch.float32 or (dtype == torch.bfloat16 and ops._is_mkldnn_bf16_supported())
    return supported


def activated_linear(weight: Float[Tensor, "out in"], bias: Tensor, is_fused: bool) -> ActivatedLayer:
    """SiLU of a linear layer."""
    if not is_fused:
        return ActivatedLayer(weight, bias, lambda values: silu(linear(values, weight, bias), inplace=True))
    packed = torch.ops.mkldnn._reorder_linear_weight(weight)
    return ActivatedLayer(weight, bias, lambda values: torch.ops.mkldnn._linear_pointwise(values, packed, bias, *_SILU))


def activated_convolution(weight: Float[Tensor, "out in 3 3"], bias: Tensor, is_fused: bool) -> ActivatedLayer:
    """SiLU of a convolution that keeps the size of a channels-last texture."""
    if not is_fused:
        return ActivatedLayer(weight, bias, lambda values: silu(conv2d(values, weight, bias, padding=1), inplace=True))
    ops = torch.ops.mkldnn
    packed = ops._reorder_convolution_weight(weight, _ONE, _ONE, _ONE, 1)
    return ActivatedLayer(
        weight, bias, lambda values: ops._convolution_pointwise(values, packed, bias, _ONE, _ONE, _ONE, 1, *_SILU)
    )


def activated_doubling(weight: Float[Tensor, "in out 4 4"], bias: Tensor, is_fused: bool) -> ActivatedLayer:
    """SiLU of a transposed convolution that doubles the size of a channels-last texture."""
    if not is_fused:
        return ActivatedLayer(
            weight, bias, lambda values: silu(conv_transpose2d(values, weight, bias, stride=2, padding=1), inplace=True)
        )
    ops, geometry = torch.ops.mkldnn, (_ONE, [0, 0], [2, 2], _ONE, 1)  # padding, more of it, stride, dilation, groups
    packed = ops._reorder_convolution_transpose_weight(weight, *geometry)
    return ActivatedLayer(
        weight, bias, lambda values: ops._convolution_transpose_pointwise(values, packed, bias, *geometry, *_SILU)
    )
