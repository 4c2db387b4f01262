"""What the network reads of a loading."""

import math

import torch

from quaffure.energies.loading import Loading
from quaffure.types import Float, Tensor

LOADING_FEATURES = 5
"""Length of `loading_features`."""
_LEAST = 0.01  # of the acceleration, in g, where its logarithm is taken


def loading_features(loading: Loading, world_from_head: Float[Tensor, "b 3 3"]) -> Float[Tensor, "b 5"]:
    """The acceleration in the head's frame [g], the logarithm of its size, and that of stiffness over it.

    The rod's shape depends on stiffness over acceleration, contact and density on one over acceleration.
    """
    pull = torch.tensor(loading.in_gravities).to(world_from_head)
    size = math.log(max(math.hypot(*loading.in_gravities), _LEAST))
    logarithms = pull.new_tensor([size, math.log(loading.mean_stiffness) - size])
    return torch.cat([pull @ world_from_head, logarithms.expand(len(world_from_head), 2)], dim=1)
