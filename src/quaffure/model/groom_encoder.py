"""A groom's rest geometry on the scalp texture to its code, Sec. 3.2."""

from itertools import pairwise

from torch import nn

from quaffure.types import Float, Tensor

CODE_SIZE = 16
"""Length of the groom code, R^16 of the paper."""


class GroomEncoder(nn.Module):
    """Strided convolutions from the 64 x 64 texture down to 4 x 4, then a code, whatever the order of strands.

    The last channel of the input says which texels hold a strand; the others are zero elsewhere. The code has no bound:
    while the autoencoder learns the mean groom, a bounded one runs into its flat ends, where no gradient is left.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        widths = (channels, 64, 64, 96, 128)
        self.down = nn.Sequential(
            *(
                layer
                for narrow, wide in pairwise(widths)
                for layer in (nn.Conv2d(narrow, wide, 3, stride=2, padding=1), nn.SiLU())
            )
        )
        self.to_code = nn.Linear(widths[-1] * 16, CODE_SIZE)

    def forward(self, rest_texture: Float[Tensor, "b channels 64 64"]) -> Float[Tensor, "b 16"]:
        code: Tensor = self.to_code(self.down(rest_texture).flatten(1))
        return code
