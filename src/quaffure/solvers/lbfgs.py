"""L-BFGS with a strong Wolfe search (Nocedal and Wright 2006, 7.2), on directions and on vertex positions.

The step length is the search's: there is no learning rate to find. The samples of a batch are one problem.
"""

import math
from collections.abc import Callable

import torch

from quaffure.config import HairMaterial
from quaffure.draper import StoppingReport
from quaffure.energies.elastic_model import ModifiedCosserat
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import Scene
from quaffure.solvers.descent import Descent, Directions, HairVariables, Offsets
from quaffure.types import Positions

MEMORY = 20
"""Steps remembered."""


class LbfgsDraper:
    """Minimizes `HairEnergy` over directions, from the closed-form sag; lengths are kept exactly.

    Attributes:
        evaluations: of the gradient, at most, but for the end of the last line search.
        elastic: name of the elastic model.
        variables: what moves the hair.
    """

    name = "lbfgs"
    variables: Callable[[HairEnergy, Scene], HairVariables] = Directions

    def __init__(
        self, material: HairMaterial | None = None, evaluations: int = 300, elastic: str = ModifiedCosserat.name
    ) -> None:
        self.material, self.evaluations, self.elastic = material or HairMaterial(), evaluations, elastic

    def drape(self, scene: Scene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        energy = HairEnergy(scene.groom, self.material, self.elastic)
        return _searched(Descent(energy, scene, self.variables(energy, scene)), self.evaluations)


class LbfgsPositionsDraper(LbfgsDraper):
    """Minimizes `HairEnergy` over vertex positions, from the posed groom. Attributes are those of `LbfgsDraper`."""

    name = "lbfgs_positions"
    variables = Offsets

    def __init__(
        self, material: HairMaterial | None = None, evaluations: int = 2000, elastic: str = ModifiedCosserat.name
    ) -> None:
        super().__init__(material, evaluations, elastic)


def _searched(descent: Descent, evaluations: int) -> tuple[Positions, StoppingReport]:
    """Search, and where a line search finds nothing lower, forget and search again, until that lowers nothing either.

    Eq. 10 is no quadratic, and what was remembered deep inside the body misleads once hair is out.
    """
    before = math.inf
    while descent.evaluations < evaluations:
        left = evaluations - descent.evaluations
        optimizer = torch.optim.LBFGS(
            descent.leaves, max_iter=left, max_eval=left, history_size=MEMORY, line_search_fn="strong_wolfe",
            tolerance_grad=0.0, tolerance_change=0.0,
        )  # fmt: skip
        at_start = float(optimizer.step(descent.loss).detach())
        if not at_start < before:
            break
        before = at_start
    return descent.finish()
