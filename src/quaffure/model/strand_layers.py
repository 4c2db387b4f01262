"""Layers common to all strands, and how many numbers they read of a strand."""

import torch
from torch import nn

from quaffure.config import EDGES_PER_STRAND
from quaffure.geometry.mls_surface import LOCAL_FEATURES
from quaffure.model.network_config import NetworkConfig
from quaffure.model.surroundings_kernels import SURROUNDING_FEATURES
from quaffure.types import Float, Tensor

OWN_FEATURES = (3 + LOCAL_FEATURES) * EDGES_PER_STRAND
"""Numbers of a strand before the network: positions of all vertices but the root, and their local features."""


class StrandLayers(nn.Module):
    """From a strand and its texel to a rotation of each joint.

    Rotations are in the head's frame and in units of the joint's compliance (`InitialShape`).
    """

    _METRES = 0.1  # unit of the positions

    def __init__(self, config: NetworkConfig, changes: int = 0) -> None:
        """
        Args:
            changes: how many numbers they read of a strand besides its features.
        """
        super().__init__()
        self._add_layers(config, changes)

    def _add_layers(self, config: NetworkConfig, changes: int) -> None:
        width = config.strand_width
        self.from_texel = nn.Linear(config.texel_channels, width)
        read = (feature_size(config) if config.skin_features else 3 * EDGES_PER_STRAND) + changes
        self.from_strand = nn.Linear(read, width, bias=False)
        between = [layer for _ in range(config.strand_layers - 1) for layer in (nn.Linear(width, width), nn.SiLU())]
        self.strand = nn.Sequential(nn.SiLU(), *between, nn.Linear(width, 3 * EDGES_PER_STRAND))
        start_at_zero(self.strand[-1])

    def rotations(
        self, texels: Float[Tensor, "b s channels"], features: Float[Tensor, "b s columns"]
    ) -> Float[Tensor, "b s e 3"]:
        """Rotation of the joint before every edge, see `DirectionNetwork.forward`."""
        weight = self.strand_weight()
        own = torch.nn.functional.linear(features[..., : weight.shape[1]], weight)
        return self.strand(self.from_texel(texels) + own).to(features).unflatten(-1, (EDGES_PER_STRAND, 3))

    def strand_weight(self) -> Float[Tensor, "width columns"]:
        """`from_strand` for positions in metres."""
        weight = self.from_strand.weight
        return torch.cat([weight[:, : 3 * EDGES_PER_STRAND] / self._METRES, weight[:, 3 * EDGES_PER_STRAND :]], dim=1)


class Refinement(StrandLayers):
    """Strand layers that read where hair is after some changes of its joints, and these changes as well."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config, 3 * EDGES_PER_STRAND)

    def forward(
        self,
        texels: Float[Tensor, "b s channels"],
        features: Float[Tensor, "b s columns"],
        changes: Float[Tensor, "b s e 3"],
    ) -> Float[Tensor, "b s e 3"]:
        """What to add to the changes.

        Args:
            features: after them.
        """
        return self.rotations(texels, torch.cat([features, changes.flatten(2)], dim=2))


def feature_size(config: NetworkConfig) -> int:
    """Numbers that the strand layers may read of a strand: its own, and what surrounds it."""
    return OWN_FEATURES + (SURROUNDING_FEATURES * EDGES_PER_STRAND if config.surroundings else 0)


def start_at_zero(layer: nn.Module) -> None:
    """An untrained network deforms nothing."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
