"""The network, what it reads, and the drape that it makes."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.model.checkpoint import load_network, save_network
    from quaffure.model.deformation_decoder import DeformationDecoder
    from quaffure.model.groom_autoencoder import GroomAutoencoder
    from quaffure.model.groom_code import load_groom_autoencoder, load_groom_encoder
    from quaffure.model.groom_encoder import GroomEncoder
    from quaffure.model.groom_texture import strands_from_features
    from quaffure.model.inference_network import ForwardNetwork, InferenceNetwork, NetworkInputs
    from quaffure.model.network_config import InitialShapeConfig, NetworkConfig, ProjectionConfig
    from quaffure.model.neural import NeuralDraper
    from quaffure.model.prepared_groom import PreparedGroom, initial_clearance, prepare_groom
    from quaffure.model.projection import project
    from quaffure.model.quaffure_model import Quaffure, load_model
    from quaffure.model.quaffure_network import DirectionNetwork, DisplacementNetwork, build_network
    from quaffure.model.strand_layers import feature_size

__all__, __getattr__, __dir__ = lazy_exports(__name__)
