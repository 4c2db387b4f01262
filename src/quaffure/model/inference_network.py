"""Networks without gradient, for drapes on the CPU: a layout of `DirectionNetwork` for speed, and any other as it is.

In the layout, doublings are folded into the convolutions that follow them, the two first strand layers are one product,
and texels stay next to their channels, so that a strand's is one row of memory.
"""

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import nn
from torch.nn.functional import interpolate

from quaffure.model.activated_layers import (
    ActivatedLayer,
    activated_convolution,
    activated_doubling,
    activated_linear,
    plain_linear,
)
from quaffure.model.deformation_decoder import DeformationDecoder
from quaffure.model.strand_layers import StrandLayers
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


def lacks_bfloat16() -> bool:
    """Whether this is an x86 processor without instructions for bfloat16, AMX or those of AVX-512. There torch converts
    to float32 and back in every layer, which takes longer than float32 alone. Of other processors nothing is known."""
    # Not public, and not in every torch; a miss leaves out a line of advice.
    probe: Callable[[], bool] = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    return platform.machine().lower() in ("x86_64", "amd64") and not (fast_bfloat16() or probe())


@dataclass(frozen=True)
class NetworkInputs:
    """A batch of drapes of one groom.

    Attributes:
        groom_code: of the groom, from the frozen encoder.
        texels: flat index of every strand's texel.
        pose_code: see `quaffure.model.pose_code`.
        features_after: gives the features of all strands after changes [b s e 3] (`DirectionNetwork.forward`).
    """

    groom_code: Float[Tensor, "16"]
    texels: Int[Tensor, " s"]
    pose_code: Float[Tensor, "b code"]
    features_after: Callable[[Tensor], Tensor]


def no_features(changes: Tensor) -> Tensor:
    """`NetworkInputs.features_after` of a network that reads its strands once.

    Raises:
        ValueError: always.
    """
    raise ValueError("expected a network without refinements, found one that reads the strands again")


class StrandTexels(NamedTuple):
    """Texels of strands in the order of the kernels' rows, the last of which repeat a strand.

    Attributes:
        flat: row times size plus column.
        rows: of `InferenceNetwork.decode_texture`, see `texture_rows`.
        strand: index of the strand of each row.
    """

    flat: Int[Tensor, " row"]
    rows: Int[Tensor, " row"]
    strand: Int[Tensor, " row"]


class ForwardNetwork:
    """A network's own `forward`, of any class, on the strands as training gives them to it: each once, in the groom's
    order, with features that the network may keep. See `InferenceNetwork`."""

    dtype = torch.float32

    def __init__(self, network: nn.Module, features: int, bf16: bool) -> None:
        self._network, self.columns, self._bf16 = network, features, bf16

    def decode_texture(
        self, groom_codes: Float[Tensor, "b 16"], pose_code: Float[Tensor, "b code"]
    ) -> list[tuple[Tensor, Tensor]]:
        return list(zip(groom_codes, pose_code.split(1)))

    @torch.no_grad()
    def changes(
        self,
        texture: tuple[Tensor, Tensor],
        texels: StrandTexels,
        features: Float[Tensor, "row columns"],
        rewrite: Callable[[Tensor], None],
    ) -> Float[Tensor, "row outputs"]:
        code, pose_code = texture
        own = texels.strand[: int(texels.strand.max()) + 1].argsort()  # rows beyond repeat a strand

        def features_after(changes: Float[Tensor, "1 s e 3"]) -> Float[Tensor, "1 s columns"]:
            rewrite(changes[0].flatten(1).float()[texels.strand])
            return features[own][None]

        with torch.autocast("cpu", torch.bfloat16, enabled=self._bf16):
            inputs = NetworkInputs(code, texels.flat[own], pose_code, features_after)
            changes = self._network(inputs, features[own][None])[0].flatten(1).float()
        return changes[texels.strand]


class InferenceNetwork:
    """Texture and strand layers of a network of edge directions, laid out for speed.

    Attributes:
        dtype: of weights and activations; sums are in float32.
        feature_size: how many numbers a strand's own shape and local features are.
        columns: these, its texel, and its changes where there are refinements.
    """

    @torch.no_grad()
    def __init__(self, decoder: DeformationDecoder, strands: Sequence[StrandLayers], dtype: torch.dtype) -> None:
        """
        Args:
            strands: the layers of all strands, then those of each refinement.
        """
        self.dtype, self.feature_size = dtype, strands[0].strand_weight().shape[1]
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
        # Channels of the four texels of a block one after another, as a pixel shuffle would not leave them.
        self._to_texels = plain_linear(
            self._stored(to_texels.weight[:, :, 0, 0].unflatten(0, (outputs, 4)).transpose(0, 1).flatten(0, 1)),
            self._stored(to_texels.bias.unflatten(0, (outputs, 4)).T.flatten()),
        )
        self._strands = [self._strand_layers(layers) for layers in strands]
        self.columns = self._strands[-1][0].weight.shape[1]

    @torch.inference_mode()
    def decode_texture(
        self, groom_codes: Float[Tensor, "b 16"], pose_code: Float[Tensor, "b code"]
    ) -> Float[Tensor, "b texels channels"]:
        """Output of `DeformationDecoder`, blocks of 2 x 2 texels one after another; see `texture_rows`."""
        values = torch.cat([groom_codes, pose_code], dim=1).to(self.dtype)
        for layer in self._dense:
            values = layer.run(values)
        texture = values.reshape(len(values), self._first_size, 4, 4).contiguous(memory_format=torch.channels_last)
        for folded, first, second in self._stages:
            texture = second.run(first.run(texture if folded else interpolate(texture, scale_factor=2)))
        blocks = texture.permute(0, 2, 3, 1).flatten(1, 2)
        return self._to_texels.run(blocks).unflatten(2, (4, -1)).flatten(1, 2)

    @torch.inference_mode()
    def changes(
        self,
        texture: Float[Tensor, "texels channels"],
        texels: StrandTexels,
        features: Float[Tensor, "s columns"],
        rewrite: Callable[[Tensor], None],
    ) -> Float[Tensor, "s outputs"]:
        """Rotation of the joint before every edge, see `DirectionNetwork`.

        Args:
            texture: a row of `decode_texture`.
            features: of each strand in the first `feature_size` columns; the others are memory.
            rewrite: writes the features after the changes so far in place of these; called before each refinement.
        """
        read = self.feature_size + texture.shape[1]
        torch.index_select(texture, 0, texels.rows, out=features[:, self.feature_size : read])
        values = features[:, :read]
        for layer in self._strands[0]:
            values = layer.run(values)
        changes = values
        for layers in self._strands[1:]:
            rewrite(changes)
            features[:, read:] = changes
            values = features
            for layer in layers:
                values = layer.run(values)
            changes = changes + values
        return changes

    def operations(self, strands: int) -> float:
        """Floating-point operations of one sample, activation functions left out."""
        of_strand = sum(layer.weight.numel() for layers in self._strands for layer in layers)
        products = sum(layer.weight.numel() for layer in self._dense) + strands * of_strand
        for side, (folded, first, second) in zip(self._sides(), self._stages):
            # Of the 16 taps of a transposed convolution of stride 2 each texel meets 4.
            products += side**2 * (first.weight.numel() // (4 if folded else 1) + second.weight.numel())
        return 2.0 * (products + self._sides()[-1] ** 2 * self._to_texels.weight.numel())

    def activations(self, strands: int) -> int:
        """Numbers that the layers write for one sample."""
        of_strand = sum(len(layer.bias) for layers in self._strands for layer in layers)
        written = sum(len(layer.bias) for layer in self._dense) + strands * of_strand
        for side, (_, first, second) in zip(self._sides(), self._stages):
            written += side**2 * (len(first.bias) + len(second.bias))
        return (
            written
            + self._sides()[-1] ** 2 * len(self._to_texels.bias)
            + strands * sum(layers[0].weight.shape[1] for layers in self._strands)
        )

    def weights(self) -> list[Tensor]:
        activated = [*self._dense, *(layer for _, first, second in self._stages for layer in (first, second))]
        of_strand = (layer for layers in self._strands for layer in layers)
        return [values for layer in (*activated, self._to_texels, *of_strand) for values in (layer.weight, layer.bias)]

    def _sides(self) -> list[int]:
        """Texels a side after each stage."""
        return [8 << stage for stage in range(len(self._stages))]

    def _strand_layers(self, layers: StrandLayers) -> list[ActivatedLayer]:
        """The first reads features and texel at once; the last has no activation."""
        weight = layers.strand_weight()
        own, changes = weight[:, : self.feature_size], weight[:, self.feature_size :]
        before = torch.cat([own, layers.from_texel.weight, changes], dim=1)
        *hidden, last = (self._affine(layer) for layer in layers.strand if isinstance(layer, nn.Linear))
        first = self._stored(before), self._stored(layers.from_texel.bias)
        return [*(activated_linear(*layer) for layer in (first, *hidden)), plain_linear(*last)]

    def _affine(self, layer: nn.Linear) -> Layer:
        return self._stored(layer.weight), self._stored(layer.bias)

    def _kernel(self, weight: Tensor, layer: nn.Conv2d) -> Layer:
        stored = self._stored(weight).contiguous(memory_format=torch.channels_last)
        return stored, self._stored(layer.bias)

    def _stored(self, values: Tensor | None) -> Tensor:
        assert values is not None
        # A copy in any case: half of the layers are, and changes of the others alone would be worse than of none.
        return values.detach().to(self.dtype, copy=True).contiguous()


def texture_rows(texels: Int[Tensor, " s"], size: int) -> Int[Tensor, " s"]:
    """Rows of `InferenceNetwork.decode_texture` of texels given by row times size plus column."""
    row, column = texels // size, texels % size
    return ((row // 2) * (size // 2) + column // 2) * 4 + (row % 2) * 2 + column % 2


def folded_doubling(weight: Float[Tensor, "wide narrow 3 3"]) -> Float[Tensor, "narrow wide 4 4"]:
    """Weights of the transposed convolution (stride 2, padding 1) that equals a doubling and a 3 x 3 convolution.

    Of a texel's three neighbours along an axis two are copies of one: their weights add up, which leaves 16 products
    of 36.
    """
    # Rows: taps of the transposed convolution; columns: those of the 3 x 3 one that read the same texel.
    taps = weight.new_tensor([[0, 0, 1], [0, 1, 1], [1, 1, 0], [1, 0, 0]])
    return torch.einsum("yj,xi,onji->noyx", taps, taps, weight)
