"""Groom autoencoder, Sec. 3.2: a whole groom in 16 numbers. Its decoder serves training and pictures only."""

import math

import torch
from torch import nn

from quaffure.config import EDGES_PER_STRAND, TEXTURE_SIZE
from quaffure.model.deformation_decoder import DeformationDecoder
from quaffure.model.groom_encoder import CODE_SIZE, GroomEncoder
from quaffure.model.groom_texture import SHAPE_CHANNELS, TEXTURE_CHANNELS
from quaffure.types import Float, Int, Tensor

Widths = tuple[int, int, int, int]
DECODED_CHANNELS = 1 + 3 * EDGES_PER_STRAND
# The largest factor by which a decoded length may leave `UNIT_LENGTH` [natural logarithm].
MOST_LOG_LENGTH = 5.0
# Standard deviation of a layer's outputs for inputs of unit variance: SiLU halves what passes it.
GAIN, OUTPUT_GAIN = 1.6, 0.5


class GroomDecoder(nn.Module):
    """Code to strands: for every texel a log length and 23 mean directions from the root.

    A vertex lies at its share of the strand's length along its mean direction, so every channel has one order of
    magnitude, near the root as at the tip. Directions are not of unit length: where strands vary at random (phase of
    curls, frizz), the best prediction is their mean, and that is shorter.

    Attributes:
        mean: added to the output of every texel; starts as the mean of the grooms to be learnt.
    """

    def __init__(self, widths: Widths) -> None:
        super().__init__()
        self.texture = DeformationDecoder(CODE_SIZE, DECODED_CHANNELS, widths)
        self.mean = nn.Parameter(torch.zeros(TEXTURE_SIZE**2, DECODED_CHANNELS))

    def forward(
        self, code: Float[Tensor, "b 16"], samples: Int[Tensor, " s"], texels: Int[Tensor, " s"]
    ) -> Float[Tensor, "s decoded"]:
        """Shape and log length of strands (the first 73 channels of `groom_texture`).

        Args:
            samples: row of `code` that each strand belongs to.
            texels: flat index of each strand's texel.
        """
        decoded = self.texture(code).mT.flatten(0, 1)
        own = decoded.index_select(0, samples * TEXTURE_SIZE**2 + texels).float()
        own = own + self.mean.index_select(0, texels)
        shape = own[:, 1:].unflatten(1, (EDGES_PER_STRAND, 3)) * _shares(own)
        log_length = own[:, :1].clamp(-MOST_LOG_LENGTH, MOST_LOG_LENGTH)
        return torch.cat([own.new_zeros(len(own), 3), shape.flatten(1), log_length], dim=1)


class GroomAutoencoder(nn.Module):
    """The encoder that is kept and the decoder that is dropped."""

    def __init__(self, widths: Widths = (256, 192, 128, 96)) -> None:
        """
        Args:
            widths: the decoder's channels at 4, 8, 16 and 32 texels a side.
        """
        super().__init__()
        self.widths = widths
        self.encoder = GroomEncoder(TEXTURE_CHANNELS)
        self.decoder = GroomDecoder(widths)
        start_layers(self, outputs=("to_code", "to_texels.0"))

    @torch.no_grad()
    def standardise(self, codes: Float[Tensor, "b 16"]) -> None:
        """Move and scale the code so that `codes` have mean 0 and variance 1, of one groom
        mean 0; what is decoded stays the same."""
        mean = codes.mean(0)
        scale = codes.std(0).clamp(min=1e-6) if len(codes) > 1 else torch.ones_like(mean)
        to_code, from_code = self.encoder.to_code, self.decoder.texture.dense[0]
        to_code.weight /= scale[:, None]
        to_code.bias.copy_((to_code.bias - mean) / scale)
        from_code.bias += from_code.weight @ mean  # type: ignore[operator]
        from_code.weight *= scale  # type: ignore[operator]


def start_layers(network: nn.Module, outputs: tuple[str, ...] = ()) -> None:
    """Draw weights that keep the size of the signal from layer to layer, and in layers of these names halve it.

    Torch's own shrink it at every layer: ten of them on, the output hardly depends on the input.
    """
    for name, layer in network.named_modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            gain = OUTPUT_GAIN if outputs and name.endswith(outputs) else GAIN
            nn.init.normal_(layer.weight, std=gain / math.sqrt(layer.weight[0].numel()))
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]


def decoded_channels(features: Float[Tensor, "s channels"]) -> Float[Tensor, "s decoded_channels"]:
    """Channels of `GroomDecoder`'s texture for strands of `strand_features`."""
    directions = features[:, 3:SHAPE_CHANNELS].unflatten(1, (EDGES_PER_STRAND, 3)) / _shares(features)
    return torch.cat([features[:, SHAPE_CHANNELS : SHAPE_CHANNELS + 1], directions.flatten(1)], dim=1)


def relative_distance(
    decoded: Float[Tensor, "s decoded"], features: Float[Tensor, "s channels"]
) -> Float[Tensor, "s e"]:
    """Distance of every vertex but the root from where it should be, in lengths of its strand.

    Args:
        decoded: of `GroomDecoder`.
        features: of `strand_features`.
    """
    longer = (decoded[:, SHAPE_CHANNELS] - features[:, SHAPE_CHANNELS]).exp()
    gap = longer[:, None] * decoded[:, 3:SHAPE_CHANNELS] - features[:, 3:SHAPE_CHANNELS]
    # A norm has no gradient at zero.
    return (gap.unflatten(1, (EDGES_PER_STRAND, 3)).square().sum(-1) + 1e-12).sqrt()


def _shares(like: Tensor) -> Float[Tensor, "e 1"]:
    """Place of every vertex but the root along its strand."""
    return torch.arange(1, EDGES_PER_STRAND + 1, device=like.device)[:, None] / EDGES_PER_STRAND
