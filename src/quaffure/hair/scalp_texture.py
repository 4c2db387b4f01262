"""At most one strand in a texel of the scalp's texture."""

import torch

from quaffure.config import TEXTURE_SIZE
from quaffure.hair.groom import Groom


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
