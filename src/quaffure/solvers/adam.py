"""Adam (Kingma and Ba 2015), on directions and on vertex positions.

Directions integrated from the root keep every rest length, so the stiff stretching term drops out and a few hundred
steps settle a groom. On vertex positions, as the paper runs it (Sec. 4.2), it crawls.
"""

import math
from collections.abc import Iterator

import torch

from quaffure.config import HairMaterial
from quaffure.energies.energy_term import Terms
from quaffure.solvers.descent import Descent, DescentDraper, Directions, Offsets

TERM_VARIABLES_RATE = 0.03
"""Learning rate of energy terms' own variables, the full rod's frame rotations, relative to that of directions."""


class AdamDraper(DescentDraper):
    """Minimizes `HairEnergy` over directions, with Eqs. 6 and 9 from their closed-form equilibrium, else as posed.

    Of 0.03, 0.1, 0.3 and 0.6 the rate of 0.3 went lowest after 100 and after 300 steps, on a straight and on a curly
    groom: see the sweep in docs/solvers.md.

    Attributes:
        steps: gradient evaluations.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
        terms: of the energy.
    """

    name = "adam"
    clips = True

    def __init__(
        self,
        material: HairMaterial | None = None,
        steps: int = 300,
        learning_rate: float = 0.3,
        terms: Terms | None = None,
    ) -> None:
        super().__init__(material, terms)
        self.steps, self.learning_rate = steps, learning_rate

    def minimize(self, descent: Descent) -> None:
        descend_directions(descent, self.steps, self.learning_rate)


class AdamPositionsDraper(AdamDraper):
    """Minimizes `HairEnergy` over vertex positions, from the posed groom.

    All rates from 1e-4 to 1e-2 m are stable in that nothing diverges; 1e-3 m goes lowest where hair starts deep inside
    the body, 3e-4 m where it does not: see the sweep in docs/solvers.md.

    Attributes are those of `AdamDraper`, the learning rate in metres.
    """

    name = "adam_positions"
    variables = Offsets

    def __init__(
        self,
        material: HairMaterial | None = None,
        steps: int = 2000,
        learning_rate: float = 1e-3,
        terms: Terms | None = None,
    ) -> None:
        super().__init__(material, steps, learning_rate, terms)

    def minimize(self, descent: Descent) -> None:
        edge = float(descent.energy.rest.rest_length.mean())
        for optimizer in _annealed(descent, self.steps, self.learning_rate, self.learning_rate / edge):
            optimizer.step()


def descend_directions(descent: Descent, steps: int, learning_rate: float) -> None:
    """Steps of Adam from the current directions; they stay of unit length.

    Args:
        descent: over `Directions`.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
    """
    directions = descent.variables
    assert isinstance(directions, Directions)
    for optimizer in _annealed(descent, steps, learning_rate, learning_rate):
        optimizer.step()
        directions.set_directions(directions.values)


def _annealed(descent: Descent, steps: int, rate: float, direction_rate: float) -> Iterator[torch.optim.Optimizer]:
    """An optimizer before each of its steps, the gradient known.

    Args:
        rate: at the start, for the hair's variables.
        direction_rate: the same as a change of a unit direction.
    """
    rates = [rate] + [TERM_VARIABLES_RATE * direction_rate] * len(descent.term_variables)
    groups = [{"params": [leaf], "lr": own} for leaf, own in zip(descent.leaves, rates)]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-20)
    for step in range(steps):
        falling = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group, own in zip(optimizer.param_groups, rates):
            group["lr"] = own * falling
        descent.loss()
        yield optimizer
