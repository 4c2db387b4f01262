"""An energy term of your own: a magnet that pulls the tips of a groom to a point.

    python examples/own_energy_term.py

A term has a name, its equation, and `energy(hair, scene)` in torch, differentiable in the positions. `HairEnergy` sums
it with the others, and every solver that needs gradients alone minimizes it.
"""

from dataclasses import dataclass

import torch

import quaffure as qf
from quaffure.energies import EnergyTerm, HairState, hair_terms
from quaffure.scene import BodyBatch, HairScene, Scene
from quaffure.solvers import AdamDraper
from quaffure.types import Energy, Float, Tensor


@dataclass(frozen=True)
class TipMagnet(EnergyTerm):
    """Half a stiffness times the squared distance of every tip from a point."""

    point: tuple[float, float, float]
    """Where the tips are pulled to [m, world]."""
    stiffness: float = 1e-3
    """[N/m]"""

    name = "tip_magnet"
    equation = "E = k / 2 sum |x_tip - p|^2"
    metric_unit = "mm"

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return 0.5 * self.stiffness * self._offsets(hair).square().sum(dim=(1, 2))

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s"]:
        return 1000 * self._offsets(hair).norm(dim=-1)

    def _offsets(self, hair: HairState) -> Float[Tensor, "b s 3"]:
        return hair.positions[:, :, -1] - hair.positions.new_tensor(self.point)


def main(strands: int = 200, steps: int = 100) -> dict[str, float]:
    """Mean distance of the tips from the point [mm], without and with the magnet."""
    groom = qf.load_groom("bob")
    groom = groom.select(torch.linspace(0, len(groom) - 1, strands).long())
    scene = Scene(groom, BodyBatch(qf.load_body(), torch.zeros(1, 81), torch.zeros(1, 10)))
    magnet = TipMagnet(point=(0.0, -0.5, 1.5))
    found = {}
    for name, terms in (("without", hair_terms()), ("with", (*hair_terms(), magnet))):
        draped = AdamDraper(steps=steps, terms=terms).drape(scene)
        found[name] = float(qf.HairEnergy(groom, terms=(magnet,)).metrics(draped, scene)[magnet.name])
        print(f"{name} the magnet the tips are {found[name]:.0f} mm from it")
    return found


if __name__ == "__main__":
    main()
