"""Adam (Kingma and Ba 2015), on directions and on vertex positions.

Directions integrated from the root keep every rest length, so the stiff stretching term drops out and a few hundred
steps settle a groom. On vertex positions, as the paper runs it (Sec. 4.2), it crawls.
"""

import math
from collections.abc import Iterator

import torch

from quaffure.config import HairMaterial
from quaffure.draper import StoppingReport
from quaffure.energies.elastic_model import ModifiedCosserat
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import Scene
from quaffure.solvers.descent import Descent, Directions, Offsets
from quaffure.types import Positions

TURNS_RATE = 0.03
"""Learning rate of the full Cosserat rod's quaternions against their edges, over that of directions."""


class AdamDraper:
    """Minimizes `HairEnergy` over directions, from the closed-form sag.

    Of 0.03, 0.1, 0.3 and 0.6 the rate of 0.3 went lowest after 100 and after 300 steps, on a straight and on a curly
    groom: see the sweep in docs/solvers.md.

    Attributes:
        steps: gradient evaluations.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
        elastic: name of the elastic model.
    """

    name = "adam"

    def __init__(
        self,
        material: HairMaterial | None = None,
        steps: int = 300,
        learning_rate: float = 0.3,
        elastic: str = ModifiedCosserat.name,
    ) -> None:
        self.material, self.elastic = material or HairMaterial(), elastic
        self.steps, self.learning_rate = steps, learning_rate

    def drape(self, scene: Scene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        energy = HairEnergy(scene.groom, self.material, self.elastic)
        directions = Directions(energy, scene)
        descent = Descent(energy, scene, directions, limited=True)
        descend_directions(descent, directions, self.steps, self.learning_rate)
        return descent.finish()


class AdamPositionsDraper:
    """Minimizes `HairEnergy` over vertex positions, from the posed groom.

    All rates from 1e-4 to 1e-2 m are stable in that nothing diverges; 1e-3 m goes lowest where hair starts deep inside
    the body, 3e-4 m where it does not: see the sweep in docs/solvers.md.

    Attributes:
        steps: gradient evaluations.
        learning_rate: at the start [m]; falls to a hundredth along a cosine.
        elastic: name of the elastic model.
    """

    name = "adam_positions"

    def __init__(
        self,
        material: HairMaterial | None = None,
        steps: int = 2000,
        learning_rate: float = 1e-3,
        elastic: str = ModifiedCosserat.name,
    ) -> None:
        self.material, self.elastic = material or HairMaterial(), elastic
        self.steps, self.learning_rate = steps, learning_rate

    def drape(self, scene: Scene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        energy = HairEnergy(scene.groom, self.material, self.elastic)
        descent = Descent(energy, scene, Offsets(energy, scene), limited=True)
        edge = float(energy.rest.rest_length.mean())
        for optimizer in _annealed(descent, self.steps, self.learning_rate, self.learning_rate / edge):
            optimizer.step()
        return descent.finish()


def descend_directions(descent: Descent, directions: Directions, steps: int, learning_rate: float) -> None:
    """Steps of Adam from where the directions are; they stay of unit length.

    Args:
        directions: the variables of `descent`.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
    """
    for optimizer in _annealed(descent, steps, learning_rate, learning_rate):
        optimizer.step()
        directions.turn_to(directions.values)


def _annealed(descent: Descent, steps: int, rate: float, turning_rate: float) -> Iterator[torch.optim.Optimizer]:
    """An optimizer about to take each of its steps, the gradient known.

    Args:
        rate: at the start, for the hair's variables.
        turning_rate: the same as a change of a unit direction.
    """
    rates = [rate, TURNS_RATE * turning_rate][: len(descent.leaves)]
    groups = [{"params": [leaf], "lr": own} for leaf, own in zip(descent.leaves, rates)]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-20)
    for step in range(steps):
        falling = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group, own in zip(optimizer.param_groups, rates):
            group["lr"] = own * falling
        descent.loss()
        yield optimizer
