"""Scalp textures: at most one strand in a texel, and conversion of strand features to textures and back."""

import torch

from quaffure.config import TEXTURE_SIZE
from quaffure.hair.groom import Groom
from quaffure.types import Bool, Float, Int, Tensor


def select_guides(groom: Groom, size: int = TEXTURE_SIZE) -> Groom:
    """At most one strand in a texel: the one whose root is nearest to the texel's centre. Ordered by texel.

    The choice does not depend on the order of the strands: ties are broken by the positions of root and tip.
    """
    texels = groom.texels(size)
    centre = torch.stack([texels % size, texels // size], dim=1) + 0.5
    off_centre = (groom.root_uv * size - centre).square().sum(1)
    # Stable sorts from the last key to the first make a lexicographic order.
    order = torch.arange(len(groom), device=texels.device)
    for key in (*groom.rest_strands[:, -1].unbind(1), *groom.root_uv.unbind(1), off_centre, texels):
        order = order[key[order].argsort(stable=True)]
    ordered = texels[order]
    first = torch.ones_like(ordered, dtype=torch.bool)
    first[1:] = ordered[1:] != ordered[:-1]
    return groom.select(order[first])


def encode(
    groom: Groom, features: Float[Tensor, "*batch s c"], size: int = TEXTURE_SIZE
) -> tuple[Float[Tensor, "*batch h w c"], Bool[Tensor, "h w"]]:
    """Features of strands as a texture, zero in texels without a strand, and the mask of texels with one.

    Raises:
        ValueError: two strands fall into one texel (`select_guides` leaves one).
    """
    texels = groom.texels(size)
    if texels.unique().numel() != len(texels):
        raise ValueError(f"expected one strand in a texel, found {len(texels)} in {texels.unique().numel()} texels")
    shape = (*features.shape[:-2], size * size, features.shape[-1])
    texture = features.new_zeros(shape).index_copy(-2, texels, features)
    return texture.unflatten(-2, (size, size)), texel_mask(groom, size)


def decode(texture: Float[Tensor, "*batch h w c"], groom: Groom) -> Float[Tensor, "*batch s c"]:
    """Values of a texture at each strand's texel; the exact inverse of `encode`."""
    return gather_texels(texture.flatten(-3, -2), groom.texels(texture.shape[-2]))


def gather_texels(flat: Float[Tensor, "*batch t c"], texels: Int[Tensor, " s"]) -> Float[Tensor, "*batch s c"]:
    """Rows of a flattened texture. `index_select`, because plain indexing has a slow backward pass."""
    return flat.index_select(-2, texels)


def texel_mask(groom: Groom, size: int = TEXTURE_SIZE) -> Bool[Tensor, "h w"]:
    """Texels with a strand."""
    mask = torch.zeros(size * size, dtype=torch.bool, device=groom.root_uv.device)
    mask[groom.texels(size)] = True
    return mask.view(size, size)
