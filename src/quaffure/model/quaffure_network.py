"""The whole network: groom encoder, deformation decoder and what turns texels into strands.

Two configurations share one interface. `DisplacementNetwork` is the paper's: the decoder's 72 channels are the
displacements of 24 vertices. `DirectionNetwork` is ours: a small network common to all strands reads the decoder's
texel and the strand's own initial shape, and predicts a rotation for each joint between edges; refinements read the
strand as these rotations leave it, and change them.
"""

import torch
from torch import nn

from quaffure.config import VERTICES_PER_STRAND
from quaffure.model.deformation_decoder import DeformationDecoder
from quaffure.model.groom_encoder import CODE_SIZE, GroomEncoder
from quaffure.model.groom_texture import TEXTURE_CHANNELS
from quaffure.model.inference_network import ForwardNetwork, InferenceNetwork, NetworkInputs
from quaffure.model.network_config import NetworkConfig
from quaffure.model.pose_code import code_size
from quaffure.model.strand_layers import Refinement, StrandLayers, feature_size, start_at_zero
from quaffure.types import Float, Tensor


class DisplacementNetwork(nn.Module):
    """The paper's configuration: R^107 to a displacement [m] of every vertex, in the head's frame."""

    _METRES = 0.05  # unit of the outputs, so that the layers work on numbers of about one

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = GroomEncoder(TEXTURE_CHANNELS).requires_grad_(False)
        self.decoder = DeformationDecoder(CODE_SIZE + code_size(config), 3 * VERTICES_PER_STRAND)
        start_at_zero(self.decoder.to_texels[0])

    def forward(self, inputs: NetworkInputs) -> Float[Tensor, "b s n 3"]:
        texture = self.decoder(_code(inputs))
        strands = texture.index_select(2, inputs.texels).mT.to(inputs.pose_code)
        return self._METRES * strands.unflatten(-1, (VERTICES_PER_STRAND, 3))


class DirectionNetwork(StrandLayers):
    """Ours: a texture from the decoder, and strand layers that read it, once and again for each refinement.

    Another `forward` of a subclass, and other layers in place of these, are run as they are by every backend.
    """

    def __init__(self, config: NetworkConfig) -> None:
        # The decoder before the layers: an optimizer's state in a checkpoint is in the order of the parameters.
        nn.Module.__init__(self)
        self.config = config
        self.encoder = GroomEncoder(TEXTURE_CHANNELS).requires_grad_(False)
        self.decoder = DeformationDecoder(CODE_SIZE + code_size(config), config.texel_channels)
        self._add_layers(config, changes=0)
        self.refinements = nn.ModuleList(Refinement(config) for _ in range(config.refinements))

    def forward(self, inputs: NetworkInputs, features: Float[Tensor, "b s columns"]) -> Float[Tensor, "b s e 3"]:
        """Rotation of the joint before every edge; the edge and all beyond it turn with it.

        Args:
            features: of every strand before the network: positions of all vertices but the root relative to the head
                and in its frame [m], then their local features (`quaffure.geometry.mls_surface`), then, where the
                configuration says so, what surrounds them (`quaffure.model.surroundings`).
        """
        texels = self.texels(inputs)
        changes = self.rotations(texels, features)
        for refinement in self.refinements:
            changes = changes + refinement(texels, inputs.features_after(changes), changes)
        return changes

    def texels(self, inputs: NetworkInputs) -> Float[Tensor, "b s channels"]:
        """What the strand layers read of the texture, the texel of every strand."""
        return self.decoder(_code(inputs)).index_select(2, inputs.texels).mT

    def for_inference(self, bf16: bool) -> InferenceNetwork | ForwardNetwork:
        """This network for drapes without gradient on the CPU, with the weights of now.

        Returns:
            A faster layout of the same function where class and layers are exactly those of this file and the skin's
            features are read; otherwise the network's own `forward`.
        """
        if type(self) is DirectionNetwork and self.config.skin_features and self._has_own_layers():
            dtype = torch.bfloat16 if bf16 else torch.float32
            return InferenceNetwork(self.decoder, [self, *self.refinements], dtype)
        return ForwardNetwork(self, feature_size(self.config), bf16)

    def _has_own_layers(self) -> bool:
        with torch.device("meta"):
            expected = DirectionNetwork(self.config)
        return not _replaces_methods(self) and all(
            _layers(getattr(self, name)) == _layers(getattr(expected, name))
            for name in ("decoder", "from_texel", "from_strand", "strand", "refinements")
        )


QuaffureNetwork = DirectionNetwork | DisplacementNetwork


def build_network(config: NetworkConfig) -> QuaffureNetwork:
    return DirectionNetwork(config) if config.predicts_directions else DisplacementNetwork(config)


def _code(inputs: NetworkInputs) -> Float[Tensor, "b inputs"]:
    return torch.cat([inputs.groom_code.expand(len(inputs.pose_code), -1), inputs.pose_code], dim=1)


def _replaces_methods(module: nn.Module) -> bool:
    """Whether a method of a module or of a layer was assigned to, as in `network.rotations = mine`."""
    return any(callable(getattr(type(part), name, None)) for part in module.modules() for name in vars(part))


def _layers(module: nn.Module) -> list[tuple[str, type, str, bool]]:
    """Name, class and settings of each layer, and whether something is hooked into it."""
    return [
        (name, type(layer), layer.extra_repr(), bool(layer._forward_hooks or layer._forward_pre_hooks))
        for name, layer in module.named_modules()
    ]
