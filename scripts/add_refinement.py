"""Weights of a network with one refinement more, and with the initial shape as it is by default now.

    python scripts/add_refinement.py OLD.safetensors NEW.safetensors

The refinement changes nothing until `quaffure train --weights NEW.safetensors` has taught it. OLD may be `shipped`.
"""

import sys
from dataclasses import replace
from pathlib import Path

from torch import nn
from torch.nn.functional import pad

from quaffure.model.checkpoint import load_network, save_network
from quaffure.model.network_config import InitialShapeConfig
from quaffure.model.quaffure_model import WEIGHTS
from quaffure.model.quaffure_network import DirectionNetwork, build_network


def main(old: str, new: str) -> None:
    network, material, notes = load_network(WEIGHTS if old == "shipped" else old)
    assert isinstance(network, DirectionNetwork)
    config = replace(network.config, refinements=network.config.refinements + 1, initial_shape=InitialShapeConfig())
    deeper = build_network(config)
    deeper.load_state_dict(network.state_dict(), strict=False)
    added = deeper.refinements[-1]
    for name, layer in added.named_modules():
        if isinstance(layer, nn.Linear) and layer is not added.strand[-1]:
            own = network.get_submodule(name)
            layer.load_state_dict(own.state_dict() | {"weight": padded(own.weight, layer.weight.shape[1])})
    save_network(Path(new), deeper, material, notes)


def padded(weight: nn.Parameter, columns: int) -> nn.Parameter:
    """With weights of zero for what the layer did not read before."""
    return pad(weight, (0, columns - weight.shape[1]))


if __name__ == "__main__":
    main(*sys.argv[1:])
