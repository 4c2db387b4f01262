"""Groom deformation decoder, Sec. 3.4: a code of groom, body shape and pose to a texture over the scalp."""

from itertools import pairwise

import torch
from torch import nn

from quaffure.config import TEXTURE_SIZE
from quaffure.types import Float, Tensor


class DeformationDecoder(nn.Module):
    """Dense layers to a 4 x 4 texture, then convolutions and doublings up to 32 x 32, then a pixel shuffle to 64 x 64.

    No 3 x 3 convolution runs at the full resolution, where it would cost more than all the others together.
    """

    def __init__(self, inputs: int, outputs: int, widths: tuple[int, int, int, int] = (256, 192, 128, 96)) -> None:
        """
        Args:
            inputs: length of the code.
            outputs: channels of the texture.
            widths: channels at 4, 8, 16 and 32 texels a side.
        """
        super().__init__()
        self.widths = widths
        self.dense = nn.Sequential(
            nn.Linear(inputs, 384), nn.SiLU(), nn.Linear(384, 384), nn.SiLU(), nn.Linear(384, 16 * widths[0]), nn.SiLU()
        )
        self.stages = nn.ModuleList(
            nn.Sequential(
                nn.Upsample(scale_factor=2),
                nn.Conv2d(narrow, wide, 3, padding=1),
                nn.SiLU(),
                nn.Conv2d(wide, wide, 3, padding=1),
                nn.SiLU(),
            )
            for narrow, wide in pairwise(widths)
        )
        self.to_texels = nn.Sequential(nn.Conv2d(widths[-1], 4 * outputs, 1), nn.PixelShuffle(2))

    def forward(self, code: Float[Tensor, "b inputs"]) -> Float[Tensor, "b outputs texels"]:
        """Channels of every texel of a 64 x 64 texture, rows one after another."""
        texture = self.dense(code).reshape(len(code), self.widths[0], 4, 4)
        texture = texture.contiguous(memory_format=torch.channels_last)
        for stage in self.stages:
            texture = stage(texture)
        return self.to_texels(texture).reshape(len(code), -1, TEXTURE_SIZE**2)
