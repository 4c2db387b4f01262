"""Strands that fold back on themselves, opened by a fraction of a millimetre.

Frames cannot be transported across two edges of opposite directions, so a rod has no rest shape there. Some files hold
such folds where strands were cut or resampled.
"""

import math

import torch
from torch.nn.functional import normalize

from quaffure.geometry.polyline import directors, integrate_directions
from quaffure.geometry.rotation import any_normal
from quaffure.types import Float, Tensor

LARGEST_BEND = math.radians(177.0)
"""Between an edge and the one before [rad]."""


def without_folds(strands: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n 3"]:
    """The strands [m] with no bend above `LARGEST_BEND`; lengths stay, and strands without folds do to the bit."""
    direction, lengths = directors(strands), strands.diff(dim=1).norm(dim=-1)
    cosine, sine = math.cos(LARGEST_BEND), math.sin(LARGEST_BEND)
    folded = (direction[:, 1:] * direction[:, :-1]).sum(-1) < cosine
    if not bool(folded.any()):
        return strands
    edges = list(direction.unbind(1))
    for edge in range(1, len(edges)):
        before, now = edges[edge - 1], edges[edge]
        along = (now * before).sum(-1, keepdim=True)
        across = now - along * before
        across = torch.where(across.norm(dim=-1, keepdim=True) > 1e-6, across, any_normal(before))
        edges[edge] = torch.where(along < cosine, cosine * before + sine * normalize(across, dim=-1), now)
    opened = integrate_directions(strands[None, :, 0], torch.stack(edges, dim=1)[None], lengths)[0]
    changed = folded.any(dim=1)[:, None, None]
    return torch.where(changed, opened, strands)
