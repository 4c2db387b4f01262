"""The table of clearances in docs/training.md: `python scripts/compare_clearances.py GROOM ...`.

The shipped network on the poses that trainings are validated on, its strands pushed out of the skin up to shares of
their collision margin; means over grooms and poses, energies in the unit of the loss.
"""

import sys
from copy import copy
from dataclasses import replace

import torch

from quaffure.body import load_body
from quaffure.energies import HairEnergy
from quaffure.io.load_groom import load_groom
from quaffure.model import NeuralDraper, load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.training import prior_validation, validation_metrics
from quaffure.types import Positions

SHARES = (None, 0.0, 0.25, 0.5, 1.0)


class ClearedDraper:
    """The network's hair as it is, or out of the skin up to a share of the collision margin."""

    name = "cleared"

    def __init__(self, network: NeuralDraper, share: float | None) -> None:
        """
        Args:
            share: None to leave the hair as the network predicts it.
        """
        self.material, self.share, layers = network.material, share, copy(network.network)
        projection = replace(layers.config.projection, clearance_share=share or 0.0)
        layers.config = replace(layers.config, projection=projection)
        self.draper = NeuralDraper(layers, self.material, network.bf16)

    def drape(self, scene: Scene) -> Positions:
        if self.share is not None:
            return self.draper.drape(scene)
        with torch.no_grad():
            return self.draper.deform(scene)


def main(names: list[str]) -> None:
    body, poses, network = load_body(), prior_validation(), load_model().draper
    bodies = BodyBatch(body, poses.body_pose, poses.body_shape)
    scenes = [Scene(load_groom(name, body), bodies) for name in names]
    pairs = [(scene, HairEnergy(scene.groom, network.material)) for scene in scenes]
    print("| out to | elastic | body contact | hair contact | sum | inside the body [%] |")
    print("|---|---|---|---|---|---|")
    for share in SHARES:
        means = validation_metrics(ClearedDraper(network, share), pairs)
        print(
            f"| {'as the network has it' if share is None else f'{share:g} of the margin'} |"
            f" {means['stretch_shear'] + means['stretch']:.3f} | {means['body_collision']:.3f} |"
            f" {means['self_collision']:.3f} | {means['energy']:.3f} | {means['body_intersection_percent']:.3f} |"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
