"""A network of your own: the strand layers read their own features twice, through a skip connection.

    python examples/own_network.py

A subclass of `DirectionNetwork` may add layers and override `forward`; training, validation and draping run that
`forward`, on every backend. It costs the faster layout, which `for_inference` returns for the original class alone.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from torch import nn

import quaffure as qf
from quaffure.body import load_pose_prior
from quaffure.model import DirectionNetwork, NetworkConfig, NetworkInputs, NeuralDraper, feature_size
from quaffure.training import DecoderRecipe, GroomedBody, PoseSampler, TrainConfig, Training, prior_validation
from quaffure.types import Float, Tensor


class SkipNetwork(DirectionNetwork):
    """Adds a linear map from a strand's features to the rotations of its joints."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.skip = nn.Linear(feature_size(config), self.strand[-1].out_features, bias=False)
        nn.init.zeros_(self.skip.weight)

    def forward(self, inputs: NetworkInputs, features: Float[Tensor, "b s columns"]) -> Float[Tensor, "b s e 3"]:
        changes = super().forward(inputs, features)
        return changes + self.skip(features[..., : self.skip.in_features]).to(changes).unflatten(-1, changes.shape[2:])


def main(steps: int = 3) -> list[float]:
    """Train on one small groom, drape with what came out; the losses [m g L per vertex]."""
    body, groom = qf.load_body(), qf.load_groom("bob")
    groom = groom.thinned(200)
    config = TrainConfig(steps=steps, runs=1, frames=2, warmup=1)
    sampler = PoseSampler(load_pose_prior())
    with TemporaryDirectory() as folder:
        network = SkipNetwork(config.network)
        recipe = DecoderRecipe(config, (GroomedBody(body, (groom,)),), sampler, prior_validation(), network=network)
        losses = [metrics["loss"] for metrics in Training(recipe, Path(folder)).steps()]
    model = qf.Quaffure(body, NeuralDraper(network, config.material), notes={})
    hair = model.drape(groom, torch.zeros(1, 81), torch.zeros(1, 10))
    print(f"losses {losses}, draped {tuple(hair.shape)}; skip weights {network.skip.weight.norm().item():.2g}")
    return losses


if __name__ == "__main__":
    main()
