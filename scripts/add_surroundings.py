"""Weights of a network that reads its strands' surroundings, from those of one that does not: they weigh nothing.

    python scripts/add_surroundings.py OLD.safetensors NEW.safetensors

The result drapes as before, and learns to use what it reads by `quaffure train --weights NEW.safetensors`.
"""

import sys
from dataclasses import replace
from pathlib import Path

from torch.nn.functional import pad

from quaffure.model.checkpoint import load_network, save_network
from quaffure.model.quaffure_network import build_network


def main(old: Path, new: Path) -> None:
    network, material, notes = load_network(old)
    wider = build_network(replace(network.config, surroundings=True))
    weights, name = network.state_dict(), "from_strand.weight"
    added = wider.state_dict()[name].shape[1] - weights[name].shape[1]
    wider.load_state_dict(weights | {name: pad(weights[name], (0, added))})
    save_network(new, wider, material, notes)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
