"""What the decoder reads of a drape besides the groom: body and loading."""

import math

import torch

from quaffure.body.head_frame import HeadFrameBody
from quaffure.energies.loading import Loading
from quaffure.model.network_config import POSE_SIZE, SHAPE_SIZE, NetworkConfig
from quaffure.types import Float, Tensor

LOADING_FEATURES = 5
"""Numbers of a loading: the acceleration in the head's frame [g], the logarithm of its size, and that of stiffness over
it. The rod's shape depends on stiffness over acceleration, contact and density on one over acceleration."""
_LEAST = 0.01  # of the acceleration, in g, where its logarithm is taken


def pose_code(config: NetworkConfig, body: HeadFrameBody, loading: Loading) -> Float[Tensor, "b code"]:
    """beta, theta, pose features (`quaffure.body.head_frame`) and, in our configuration, the loading."""
    used = body.pose_code[:, : SHAPE_SIZE + POSE_SIZE + config.pose_features]
    if not config.predicts_directions:
        return used
    pull = torch.tensor(loading.in_gravities).to(body.world_from_head)
    size = math.log(max(math.hypot(*loading.in_gravities), _LEAST))
    stiffness = torch.as_tensor(loading.stiffness).to(pull).log().mean()
    logarithms = torch.stack([pull.new_tensor(size), stiffness - size])
    return torch.cat([used, pull @ body.world_from_head, logarithms.expand(len(used), 2)], dim=1)


def code_size(config: NetworkConfig) -> int:
    """Length of `pose_code`."""
    loading = LOADING_FEATURES if config.predicts_directions else 0
    return SHAPE_SIZE + POSE_SIZE + config.pose_features + loading
