"""A network's drape as the start of a few steps of Adam: how much of what it misses is a matter of polish."""

import math

import torch

from quaffure.drapers.descent import Descent, Directions
from quaffure.drapers.neural import NeuralDraper
from quaffure.drapers.scene import Scene
from quaffure.energies.hair_energy import HairEnergy
from quaffure.types import Positions


class RefinedDraper:
    """Minimizes `HairEnergy` over directions from where a network leads.

    Attributes:
        start: the network.
        steps: gradient evaluations.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
    """

    name = "neural_refined"

    def __init__(self, start: NeuralDraper, steps: int = 10, learning_rate: float = 0.01) -> None:
        self.start, self.material = start, start.material
        self.steps, self.learning_rate = steps, learning_rate

    def drape(self, scene: Scene) -> Positions:
        energy = HairEnergy(scene.groom, self.material)
        directions = Directions(energy, scene)
        _set(directions, self.start.drape(scene).diff(dim=2))
        descent = Descent(energy, scene, directions, limited=True)
        optimizer = torch.optim.Adam([directions.values], betas=(0.9, 0.99), eps=1e-20)
        for step in range(self.steps):
            falling = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / self.steps))
            optimizer.param_groups[0]["lr"] = self.learning_rate * falling
            descent.loss()
            optimizer.step()
            _set(directions, directions.values)
        return directions.positions().detach()


@torch.no_grad()
def _set(directions: Directions, edges: torch.Tensor) -> None:
    directions.values.copy_(torch.nn.functional.normalize(edges, dim=-1))
