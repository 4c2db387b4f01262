"""Batches for the groom autoencoder: grooms to encode, and strands that the decoder should give."""

import math
from dataclasses import dataclass

import torch
from scipy.ndimage import distance_transform_edt

from quaffure.config import TEXTURE_SIZE
from quaffure.model.groom_autoencoder import DECODED_CHANNELS, decoded_channels
from quaffure.model.groom_texture import SHAPE_CHANNELS, TEXTURE_CHANNELS, GroomSample
from quaffure.types import Float, Int, Tensor


@dataclass(frozen=True)
class GroomBatch:
    """Grooms on the scalp texture, and strands that their codes should give back.

    Attributes:
        textures: input of the encoder.
        features: of the strands to be decoded, of all grooms one after another (see `groom_texture`).
        samples: the groom that each of these strands belongs to.
        texels: the texel of each one's root.
    """

    textures: Float[Tensor, "b channels 64 64"]
    features: Float[Tensor, "s channels"]
    samples: Int[Tensor, " s"]
    texels: Int[Tensor, " s"]


def batch_of(inputs: list[GroomSample], targets: list[GroomSample]) -> GroomBatch:
    """A batch of grooms to be encoded, each with a groom of the same style to be decoded."""
    features, samples, texels = _joined(inputs)
    flat = torch.zeros(len(inputs) * TEXTURE_SIZE**2, TEXTURE_CHANNELS)
    flat.index_copy_(0, samples * TEXTURE_SIZE**2 + texels, features)
    textures = flat.view(len(inputs), TEXTURE_SIZE, TEXTURE_SIZE, TEXTURE_CHANNELS).permute(0, 3, 1, 2)
    return GroomBatch(textures, *_joined(targets))


def _joined(grooms: list[GroomSample]) -> tuple[Float[Tensor, "s channels"], Int[Tensor, " s"], Int[Tensor, " s"]]:
    counts = torch.tensor([len(groom.texels) for groom in grooms])
    samples = torch.repeat_interleave(torch.arange(len(grooms)), counts)
    features = torch.cat([groom.features for groom in grooms]).float()
    return features, samples, torch.cat([groom.texels for groom in grooms])


def mirrored(groom: GroomSample) -> GroomSample:
    """Left and right exchanged: the chart is its own mirror image, and so are the frames of its roots."""
    row, column = groom.texels // TEXTURE_SIZE, groom.texels % TEXTURE_SIZE
    features = groom.features.clone()
    features[:, 0:SHAPE_CHANNELS:3] *= -1
    return GroomSample(groom.style, features, row * TEXTURE_SIZE + TEXTURE_SIZE - 1 - column)


def scaled(groom: GroomSample, factor: float) -> GroomSample:
    """All strands longer by a factor, of the same shape."""
    features = groom.features.clone()
    features[:, SHAPE_CHANNELS] += math.log(factor)
    return GroomSample(groom.style, features, groom.texels)


def part_of(groom: GroomSample, share: float, generator: torch.Generator) -> GroomSample:
    """Some of the strands, each kept with the chance `share`; at least one."""
    chance = torch.rand(len(groom.texels), generator=generator)
    kept = torch.nonzero(chance < max(share, float(chance.min()) + 1e-6))[:, 0]
    return GroomSample(groom.style, groom.features[kept], groom.texels[kept])


def patch_of(groom: GroomSample, low: Float[Tensor, "2"], high: Float[Tensor, "2"]) -> GroomSample:
    """The strands of a rectangle of the scalp's chart, whose corners are given from 0 to 1."""
    position = (torch.stack([groom.texels % TEXTURE_SIZE, groom.texels // TEXTURE_SIZE], dim=1) + 0.5) / TEXTURE_SIZE
    kept = torch.nonzero(((position > low) & (position < high)).all(1))[:, 0]
    return GroomSample(groom.style, groom.features[kept], groom.texels[kept])


def mean_strands(grooms: list[GroomSample]) -> Float[Tensor, "texels decoded"]:
    """Mean target of a decoder in every texel; where no groom has a strand, that of the nearest texel with one."""
    sums, counts = torch.zeros(TEXTURE_SIZE**2, DECODED_CHANNELS), torch.zeros(TEXTURE_SIZE**2)
    for groom in grooms:
        sums.index_add_(0, groom.texels, decoded_channels(groom.features.float()))
        counts.index_add_(0, groom.texels, torch.ones(len(groom.texels)))
    bald = (counts == 0).view(TEXTURE_SIZE, TEXTURE_SIZE).numpy()
    row, column = distance_transform_edt(bald, return_distances=False, return_indices=True)
    return (sums / counts.clamp(min=1)[:, None])[torch.from_numpy(row * TEXTURE_SIZE + column).flatten().long()]
