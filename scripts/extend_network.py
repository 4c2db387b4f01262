"""Weights of an older network, with refinements and with the steps around the network as they are by default now.

    python scripts/extend_network.py OLD.safetensors NEW.safetensors [REFINEMENTS]

Refinements that OLD does not have (1 in all by default) change nothing until `quaffure train --weights NEW.safetensors`
has taught them. OLD may be `shipped`.
"""

import sys
from dataclasses import replace
from pathlib import Path

from torch import nn
from torch.nn.functional import pad

from quaffure.model.checkpoint import load_network, save_network
from quaffure.model.network_config import InitialShapeConfig, ProjectionConfig
from quaffure.model.quaffure_model import WEIGHTS
from quaffure.model.quaffure_network import DirectionNetwork, build_network


def main(old: str, new: str, refinements: str = "1") -> None:
    network, material, notes = load_network(WEIGHTS if old == "shipped" else old)
    assert isinstance(network, DirectionNetwork)
    steps = {"initial_shape": InitialShapeConfig(), "projection": ProjectionConfig()}
    extended = build_network(replace(network.config, refinements=int(refinements), **steps))
    assert isinstance(extended, DirectionNetwork)
    extended.load_state_dict(network.state_dict(), strict=False)
    for added in extended.refinements[network.config.refinements :]:
        for name, layer in added.named_modules():
            if isinstance(layer, nn.Linear) and layer is not added.strand[-1]:
                own = network.get_submodule(name)
                layer.load_state_dict(own.state_dict() | {"weight": padded(own.weight, layer.weight.shape[1])})
    save_network(Path(new), extended, material, notes)


def padded(weight: nn.Parameter, columns: int) -> nn.Parameter:
    """With weights of zero for what the layer did not read before."""
    return pad(weight, (0, columns - weight.shape[1]))


if __name__ == "__main__":
    main(*sys.argv[1:])
