"""Weights with the configuration that rebuilds their network, in one safetensors file."""

import json
from dataclasses import asdict
from pathlib import Path

import torch

from quaffure.config import HairMaterial
from quaffure.errors import InputError, refused
from quaffure.file_values import material_from
from quaffure.model.groom_code import load_groom_encoder
from quaffure.model.network_config import from_file_values, to_file_values
from quaffure.model.quaffure_network import QuaffureNetwork, build_network
from quaffure.model.weights_file import read_weights, save_weights
from quaffure.types import Tensor

FORMAT = "5"
"""Changes whenever the same weights would come to mean something else: since 2, outputs count in compliance; since 3,
contact is resolved twice before the network (`quaffure.model.initial_shape`); since 4, contact forces are estimated on
cluster representatives, and very short hair starts at its rest shape; since 5, outputs are rotations of joints from a
rod's equilibrium, under a loading."""


def save_network(path: Path, network: QuaffureNetwork, material: HairMaterial, notes: dict[str, str]) -> None:
    """Write half-precision weights, the network's configuration and the material that it was trained for.

    Weights of the shipped groom encoder are left out: no training changes them.
    """
    own = network.state_dict()
    shipped = {name for name, value in _encoder_weights().items() if torch.equal(own[name].cpu(), value)}
    settings = {"network": json.dumps(to_file_values(network.config)), "material": json.dumps(asdict(material))}
    save_weights(path, network, {"format": FORMAT, **settings, **notes}, without=shipped)


def load_network(path: str | Path) -> tuple[QuaffureNetwork, HairMaterial, dict[str, str]]:
    """A network in evaluation mode, its material, and the notes saved with it.

    Raises:
        InputError: the file is missing, not a checkpoint of this package, or of another version of it.
    """
    path = Path(path)
    weights, notes = read_weights(path, "a checkpoint (.safetensors)")
    found = notes.pop("format", "1")
    if "network" in notes and found != FORMAT:
        raise InputError(path, f"weights of format {FORMAT}", f"format {found}, of another version of this package")
    # Notes are JSON of any kind, and tensors of any shape.
    with refused(path, "a checkpoint of this package", Exception):
        config = from_file_values(json.loads(notes.pop("network")))
        material = material_from(json.loads(notes.pop("material")))
        network = build_network(config)
        network.load_state_dict(_encoder_weights() | weights)
    return network.eval(), material, notes


def _encoder_weights() -> dict[str, Tensor]:
    """Weights of the shipped groom encoder by the names that they have in a network."""
    return {f"encoder.{name}": value for name, value in load_groom_encoder().state_dict().items()}
