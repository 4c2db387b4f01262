"""Gravitational potential, Eq. 9."""

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Positions, Tensor

GRAVITY = (0.0, 0.0, -STANDARD_GRAVITY)
"""Gravitational acceleration g [m/s^2]; z is up."""


def energy_gravity(positions: Positions, mass: Float[Tensor, "s n"]) -> Energy:
    """Eq. 9: -m g^T x over all vertices [J], for masses [kg] and positions [m]; zero at height zero."""
    return -(mass * (positions @ positions.new_tensor(GRAVITY))).sum(dim=(-2, -1))


def energy_gravity_above_root(positions: Positions, mass: Float[Tensor, "s n"]) -> Energy:
    """Eq. 9 measured from each strand's own root, which is held fixed, so that no large constant rounds the sum.

    A head is 1.6 m above the origin and a strand's drop a tenth of that: float32 sums keep one more digit this way.
    The gradient is that of Eq. 9, also at the roots.
    """
    return energy_gravity(positions - positions[..., :1, :].detach(), mass)


class Gravity(EnergyTerm):
    """Eq. 9, above the roots."""

    name = "gravity"
    equation = "Eq. 9"
    metric_unit = "mm"

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return energy_gravity_above_root(hair.positions, hair.rest.mass)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s n"]:
        """Height of every vertex above its root [mm]."""
        return 1000 * (hair.positions - hair.positions[:, :, :1])[..., 2]
