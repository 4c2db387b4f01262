"""L-BFGS with a strong Wolfe search (Nocedal and Wright 2006, 7.2), on directions and on vertex positions.

The search finds the step length: there is no learning rate to choose. The samples of a batch are one problem.
"""

import math

import torch

from quaffure.config import HairMaterial
from quaffure.energies.energy_term import Terms
from quaffure.solvers.descent import Descent, DescentDraper, Offsets

HISTORY_SIZE = 20
"""Steps remembered."""


class LbfgsDraper(DescentDraper):
    """Minimizes `HairEnergy` over directions, with Eqs. 6 and 9 from their closed-form equilibrium, else as posed.
    Lengths are kept exactly.

    Unlike those of the other drapers, its last bits depend on the number of threads: torch's optimizer takes inner
    products by MKL.

    Attributes:
        evaluations: of the gradient, at most, but for the end of the last line search.
        terms: of the energy.
    """

    name = "lbfgs"

    def __init__(
        self, material: HairMaterial | None = None, evaluations: int = 300, terms: Terms | None = None
    ) -> None:
        super().__init__(material, terms)
        self.evaluations = evaluations

    def minimize(self, descent: Descent) -> None:
        """Search, and where a line search finds nothing lower, forget and search again, until that lowers nothing.

        Eq. 10 is not quadratic, and steps remembered deep inside the body mislead once hair is out.
        """
        before = math.inf
        while descent.evaluations < self.evaluations:
            left = self.evaluations - descent.evaluations
            optimizer = torch.optim.LBFGS(
                descent.leaves, max_iter=left, max_eval=left, history_size=HISTORY_SIZE, line_search_fn="strong_wolfe",
                tolerance_grad=0.0, tolerance_change=0.0,
            )  # fmt: skip
            at_start = float(optimizer.step(descent.loss).detach())
            if not at_start < before:
                return
            before = at_start


class LbfgsPositionsDraper(LbfgsDraper):
    """Minimizes `HairEnergy` over vertex positions, from the posed groom. Attributes are those of `LbfgsDraper`."""

    name = "lbfgs_positions"
    variables = Offsets

    def __init__(
        self, material: HairMaterial | None = None, evaluations: int = 2000, terms: Terms | None = None
    ) -> None:
        super().__init__(material, evaluations, terms)
