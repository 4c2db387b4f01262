"""The whole network: groom encoder, deformation decoder and what turns texels into strands.

Two configurations share one interface. `DisplacementNetwork` is the paper's: the decoder's 72 channels are the
displacements of 24 vertices. `DirectionNetwork` is ours: a small network common to all strands reads the decoder's
texel and the strand's own initial shape, and answers a change of direction for each edge.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import nn

from quaffure.config import EDGES_PER_STRAND, VERTICES_PER_STRAND
from quaffure.geometry.mls_surface import LOCAL_FEATURES
from quaffure.model.deformation_decoder import DeformationDecoder
from quaffure.model.groom_encoder import CODE_SIZE, GroomEncoder
from quaffure.model.groom_texture import TEXTURE_CHANNELS
from quaffure.model.weights_file import MAX_WIDTH
from quaffure.types import Float, Int, Tensor

POSE_SIZE, SHAPE_SIZE = 81, 10
MAX_LAYERS = 64


@dataclass(frozen=True)
class NetworkConfig:
    """What a checkpoint needs to rebuild its network."""

    output: Literal["directions", "displacement"] = "directions"
    """`directions` (ours): changes of edge directions, integrated. `displacement` (the paper's): of vertices."""
    pose_features: int = 0
    """Length of the analytic pose features appended to the paper's R^107; 0 leaves them out."""
    texel_channels: int = 48
    """Channels of the decoder's texture that the strand layers read (`directions` only)."""
    strand_width: int = 128
    """Width of the layers common to all strands (`directions` only)."""
    strand_layers: int = 2
    """Hidden layers common to all strands, the first included (`directions` only)."""
    views: bool = True
    """The strand layers see the skin near the initial strand, or, with `--no-views`, do not (`directions` only)."""
    slides: bool = True
    """The initial strand slides along the softened body or, with `--no-slides`, only sags (`directions` only)."""

    def __post_init__(self) -> None:
        if self.output not in ("directions", "displacement"):
            raise ValueError(f"expected output directions or displacement, found {self.output!r}")
        widths = {"pose_features": (0, MAX_WIDTH), "texel_channels": (1, MAX_WIDTH), "strand_width": (1, MAX_WIDTH)}
        for name, (least, most) in (widths | {"strand_layers": (1, MAX_LAYERS)}).items():
            value = getattr(self, name)
            if not (isinstance(value, int) and least <= value <= most):
                raise ValueError(f"expected {name} from {least} to {most}, found {value!r}")


@dataclass(frozen=True)
class NetworkInputs:
    """A batch of drapes of one groom.

    Attributes:
        groom_code: of the groom, from the frozen encoder.
        texels: flat index of every strand's texel.
        pose_code: beta, theta [rad] without heading, and the pose features (`quaffure.body.head_frame`).
    """

    groom_code: Float[Tensor, "16"]
    texels: Int[Tensor, " s"]
    pose_code: Float[Tensor, "b code"]


class DisplacementNetwork(nn.Module):
    """The paper's configuration: R^107 to a displacement [m] of every vertex, in the head's frame."""

    _METRES = 0.05  # what an output of one means, so that the layers work on numbers of about one

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = GroomEncoder(TEXTURE_CHANNELS).requires_grad_(False)
        inputs = CODE_SIZE + SHAPE_SIZE + POSE_SIZE + config.pose_features
        self.decoder = DeformationDecoder(inputs, 3 * VERTICES_PER_STRAND)
        _start_at_zero(self.decoder.to_texels[0])

    def forward(self, inputs: NetworkInputs) -> Float[Tensor, "b s n 3"]:
        texture = self.decoder(_code(self.config, inputs))
        strands = texture.index_select(2, inputs.texels).mT.float()
        return self._METRES * strands.unflatten(-1, (VERTICES_PER_STRAND, 3))


class DirectionNetwork(nn.Module):
    """Ours: a change of every edge's direction, in the head's frame, dimensionless."""

    _METRES = 0.1

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = GroomEncoder(TEXTURE_CHANNELS).requires_grad_(False)
        inputs = CODE_SIZE + SHAPE_SIZE + POSE_SIZE + config.pose_features
        self.decoder = DeformationDecoder(inputs, config.texel_channels)
        width = config.strand_width
        self.from_texel = nn.Linear(config.texel_channels, width)
        seen = LOCAL_FEATURES * EDGES_PER_STRAND if config.views else 0
        self.from_strand = nn.Linear(3 * EDGES_PER_STRAND + seen, width, bias=False)
        between = [layer for _ in range(config.strand_layers - 1) for layer in (nn.Linear(width, width), nn.SiLU())]
        self.strand = nn.Sequential(nn.SiLU(), *between, nn.Linear(width, 3 * EDGES_PER_STRAND))
        _start_at_zero(self.strand[-1])

    def forward(self, inputs: NetworkInputs, told: Float[Tensor, "b s columns"]) -> Float[Tensor, "b s e 3"]:
        """Change of every edge.

        Args:
            told: of every strand where it would be without the network: positions of all vertices but the root relative
                to the head and in its frame [m], then what they see of the skin (`quaffure.geometry.mls_surface`).
        """
        texture = self.decoder(_code(self.config, inputs))
        texels = texture.index_select(2, inputs.texels).mT
        weight = self.strand_weight()
        own = torch.nn.functional.linear(told[..., : weight.shape[1]], weight)
        return self.strand(self.from_texel(texels) + own).float().unflatten(-1, (EDGES_PER_STRAND, 3))

    def strand_weight(self) -> Float[Tensor, "width columns"]:
        """`from_strand` for positions in metres."""
        weight = self.from_strand.weight
        return torch.cat([weight[:, : 3 * EDGES_PER_STRAND] / self._METRES, weight[:, 3 * EDGES_PER_STRAND :]], dim=1)


QuaffureNetwork = DirectionNetwork | DisplacementNetwork


def build_network(config: NetworkConfig) -> QuaffureNetwork:
    return DirectionNetwork(config) if config.output == "directions" else DisplacementNetwork(config)


def _code(config: NetworkConfig, inputs: NetworkInputs) -> Float[Tensor, "b inputs"]:
    """The paper's R^107, groom code, beta and theta, followed by the pose features where they are used."""
    pose_code = inputs.pose_code[:, : SHAPE_SIZE + POSE_SIZE + config.pose_features]
    return torch.cat([inputs.groom_code.expand(len(pose_code), -1), pose_code], dim=1)


def _start_at_zero(layer: nn.Module) -> None:
    """An untrained network deforms nothing."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
