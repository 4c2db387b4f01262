"""A trained `DirectionNetwork` laid out for speed: the same function, evaluated with fewer operations.

Doublings are folded into the convolutions that follow them, the two first strand layers are one product, and texels
stay next to their channels, so that a strand's is one row of memory.
"""

from collections.abc import Callable

import torch
from torch import nn
from torch.nn.functional import interpolate, linear, silu

from quaffure.model.activated_layers import (
    ActivatedLayer,
    activated_convolution,
    activated_doubling,
    activated_linear,
)
from quaffure.model.quaffure_network import DirectionNetwork
from quaffure.types import Float, Int, Tensor

Layer = tuple[Tensor, Tensor]
"""Weight and bias."""
# A doubling in front of few texels is cheaper than the transposed convolution that replaces it.
_FOLD_FROM = 8


def fast_bfloat16() -> bool:
    """Whether this processor multiplies matrices of bfloat16 in hardware (AMX)."""
    # Not public, and not in every torch; a miss costs time and nothing else.
    probe: Callable[[], bool] = getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    return bool(probe())


class InferenceNetwork:
    """Texture and strand layers of a `DirectionNetwork` that sees the skin, without gradient.

    Attributes:
        dtype: of weights and activations; sums are in float32.
        told_size: how many numbers a strand's own shape and views are.
    """

    @torch.no_grad()
    def __init__(self, network: DirectionNetwork, dtype: torch.dtype) -> None:
        self.dtype, self.config = dtype, network.config
        self.told_size = network.from_strand.in_features
        decoder = network.decoder
        dense = (layer for layer in decoder.dense if isinstance(layer, nn.Linear))
        self._dense = [activated_linear(*self._affine(layer)) for layer in dense]
        self._first_size = decoder.widths[0]
        self._stages: list[tuple[bool, ActivatedLayer, ActivatedLayer]] = []
        for index, stage in enumerate(decoder.stages):
            doubled, second = (layer for layer in stage.children() if isinstance(layer, nn.Conv2d))
            folded = 4 << index >= _FOLD_FROM
            weight = folded_doubling(doubled.weight) if folded else doubled.weight
            activated = activated_doubling if folded else activated_convolution
            first = activated(*self._kernel(weight, doubled))
            self._stages.append((folded, first, activated_convolution(*self._kernel(second.weight, second))))
        to_texels = decoder.to_texels[0]
        assert isinstance(to_texels, nn.Conv2d)
        assert to_texels.bias is not None
        outputs = to_texels.out_channels // 4
        # Channels of the four texels of a place one after another, as a pixel shuffle would not leave them.
        self._to_texels = (
            self._stored(to_texels.weight[:, :, 0, 0].unflatten(0, (outputs, 4)).transpose(0, 1).flatten(0, 1)),
            self._stored(to_texels.bias.unflatten(0, (outputs, 4)).T.flatten()),
        )
        before = torch.cat([network.strand_weight(), network.from_texel.weight], dim=1)
        self._strand = [(self._stored(before), self._stored(network.from_texel.bias))]
        self._strand += [self._affine(layer) for layer in network.strand if isinstance(layer, nn.Linear)]

    @torch.inference_mode()
    def textures(self, code: Float[Tensor, "b inputs"]) -> Float[Tensor, "b texels channels"]:
        """What `DeformationDecoder` answers, places of 2 x 2 texels one after another; see `texel_rows`."""
        values = code.to(self.dtype)
        for layer in self._dense:
            values = layer(values)
        texture = values.reshape(len(code), self._first_size, 4, 4).contiguous(memory_format=torch.channels_last)
        for folded, first, second in self._stages:
            texture = second(first(texture if folded else interpolate(texture, scale_factor=2)))
        places = texture.permute(0, 2, 3, 1).flatten(1, 2)
        return linear(places, *self._to_texels).unflatten(2, (4, -1)).flatten(1, 2)

    @torch.inference_mode()
    def answers(
        self, texture: Float[Tensor, "texels channels"], rows: Int[Tensor, " s"], inputs: Float[Tensor, "s size"]
    ) -> Float[Tensor, "s answers"]:
        """Change of every edge's direction.

        Args:
            texture: of one sample.
            rows: of the strands' texels, see `texel_rows`.
            inputs: a strand's positions [m] and views in its first `told_size` columns; the others are filled here.
        """
        torch.index_select(texture, 0, rows, out=inputs[:, self.told_size :])
        values = inputs
        for weight, bias in self._strand[:-1]:
            values = silu(linear(values, weight, bias), inplace=True)
        return linear(values, *self._strand[-1])

    def inputs(self, strands: int) -> Float[Tensor, "s size"]:
        """Room for what `answers` reads."""
        return torch.empty(strands, self._strand[0][0].shape[1], dtype=self.dtype)

    def operations(self, strands: int) -> float:
        """Floating-point operations of one sample, activation functions left out."""
        products = sum(layer.weight.numel() for layer in self._dense) + strands * sum(
            w.numel() for w, _ in self._strand
        )
        for side, (folded, first, second) in zip(self._sides(), self._stages):
            # Of the 16 taps of a transposed convolution of stride 2 each texel meets 4.
            products += side**2 * (first.weight.numel() // (4 if folded else 1) + second.weight.numel())
        return 2.0 * (products + self._sides()[-1] ** 2 * self._to_texels[0].numel())

    def activations(self, strands: int) -> int:
        """Numbers that the layers write for one sample."""
        written = sum(len(layer.bias) for layer in self._dense) + strands * sum(len(bias) for _, bias in self._strand)
        for side, (_, first, second) in zip(self._sides(), self._stages):
            written += side**2 * (len(first.bias) + len(second.bias))
        return written + self._sides()[-1] ** 2 * len(self._to_texels[1]) + strands * self._strand[0][0].shape[1]

    def weights(self) -> list[Tensor]:
        activated = [*self._dense, *(layer for _, first, second in self._stages for layer in (first, second))]
        layers = [(layer.weight, layer.bias) for layer in activated]
        return [values for layer in (*layers, self._to_texels, *self._strand) for values in layer]

    def _sides(self) -> list[int]:
        """Texels a side after each stage."""
        return [8 << stage for stage in range(len(self._stages))]

    def _affine(self, layer: nn.Linear) -> Layer:
        return self._stored(layer.weight), self._stored(layer.bias)

    def _kernel(self, weight: Tensor, layer: nn.Conv2d) -> Layer:
        stored = self._stored(weight).contiguous(memory_format=torch.channels_last)
        return stored, self._stored(layer.bias)

    def _stored(self, values: Tensor | None) -> Tensor:
        assert values is not None
        # A copy in any case: half of the layers are, and changes of the others alone would be worse than of none.
        return values.detach().to(self.dtype, copy=True).contiguous()


def texel_rows(texels: Int[Tensor, " s"], size: int) -> Int[Tensor, " s"]:
    """Rows of `InferenceNetwork.textures` of texels given by row times size plus column."""
    row, column = texels // size, texels % size
    return ((row // 2) * (size // 2) + column // 2) * 4 + (row % 2) * 2 + column % 2


def folded_doubling(weight: Float[Tensor, "wide narrow 3 3"]) -> Float[Tensor, "narrow wide 4 4"]:
    """Weights of the transposed convolution (stride 2, padding 1) that equals a doubling and a 3 x 3 convolution.

    Of a texel's three neighbours along an axis two are copies of one: their weights add up, which leaves 16 products
    of 36.
    """
    # Rows: taps of the transposed convolution; columns: those of the 3 x 3 one that see the same texel.
    taps = weight.new_tensor([[0, 0, 1], [0, 1, 1], [1, 1, 0], [1, 0, 0]])
    return torch.einsum("yj,xi,onji->noyx", taps, taps, weight)
