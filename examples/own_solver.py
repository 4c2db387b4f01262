"""A solver of your own: gradient descent with momentum (Polyak 1964) on the directions of the edges.

    python examples/own_solver.py

A draper has a name, a material and `drape(scene)`. One that follows the gradient derives from `DescentDraper`, which
brings the variables, the loss, the energy's terms and the report of where it stopped; only the steps are left to write.
"""

import torch

import quaffure as qf
from quaffure.config import HairMaterial
from quaffure.energies import Terms
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import AdamDraper, Descent, DescentDraper


class MomentumDraper(DescentDraper):
    """Heavy-ball descent; forces on single vertices are limited, so that deep contact does not throw strands about."""

    name = "momentum"
    clips = True

    def __init__(
        self, material: HairMaterial | None = None, steps: int = 200, rate: float = 0.3, terms: Terms | None = None
    ) -> None:
        super().__init__(material, terms)
        self.steps, self.rate = steps, rate

    def minimize(self, descent: Descent) -> None:
        optimizer = torch.optim.SGD(descent.leaves, lr=self.rate, momentum=0.9)
        for _ in range(self.steps):
            descent.loss()
            optimizer.step()


def main(strands: int = 200, steps: int = 200) -> dict[str, float]:
    """Energy above that of Adam's drape [m g L per vertex], at the start and at the end."""
    groom = qf.load_groom("bob").thinned(strands)
    scene = Scene(groom, BodyBatch(qf.load_body(), torch.zeros(1, 81), torch.zeros(1, 10)))
    energy = qf.HairEnergy(groom)

    def height(draped: torch.Tensor) -> float:
        return float(energy.per_vertex(energy.total(draped, scene)))

    best = height(AdamDraper(steps=steps).drape(scene))
    found = {"posed": height(scene.posed) - best, "momentum": height(MomentumDraper(steps=steps).drape(scene)) - best}
    print({name: round(value, 4) for name, value in found.items()})
    return found


if __name__ == "__main__":
    main()
