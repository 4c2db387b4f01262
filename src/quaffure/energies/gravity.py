"""Gravitational potential, Eq. 9, of any uniform acceleration."""

from dataclasses import dataclass

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.errors import InputError
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Positions, Tensor

Acceleration = tuple[float, float, float]
"""In the world's axes [m/s^2]."""
GRAVITY: Acceleration = (0.0, 0.0, -STANDARD_GRAVITY)
"""Gravitational acceleration g; z is up."""
NO_ACCELERATION: Acceleration = (0.0, 0.0, 0.0)
LARGEST_ACCELERATION = 2e4
"""Limit of each component [m/s^2], 2,000 times that of gravity; float32 no longer does at 100 times as much."""


def check_acceleration(acceleration: Acceleration) -> None:
    """Refuse an acceleration that is not three numbers [m/s^2] within `LARGEST_ACCELERATION`.

    Raises:
        InputError: it is one.
    """
    if len(acceleration) != 3 or not all(abs(part) <= LARGEST_ACCELERATION for part in acceleration):
        raise InputError("acceleration", f"three numbers within +-{LARGEST_ACCELERATION:g} m/s^2", f"{acceleration}")


def energy_gravity(positions: Positions, mass: Float[Tensor, "s n"], acceleration: Acceleration = GRAVITY) -> Energy:
    """Eq. 9: -m g^T x over all vertices [J], for masses [kg] and positions [m]; zero at the origin."""
    return -(mass * (positions @ positions.new_tensor(acceleration))).sum(dim=(-2, -1))


def energy_gravity_above_root(
    positions: Positions, mass: Float[Tensor, "s n"], acceleration: Acceleration = GRAVITY
) -> Energy:
    """Eq. 9 measured from each strand's own root, which is held fixed, so that no large constant rounds the sum.

    A head is 1.6 m above the origin and a strand's drop a tenth of that: float32 sums keep one more digit this way.
    The gradient is that of Eq. 9, also at the roots.
    """
    return energy_gravity(positions - positions[..., :1, :].detach(), mass, acceleration)


@dataclass(frozen=True)
class Gravity(EnergyTerm):
    """Eq. 9, above the roots.

    Attributes:
        acceleration: of gravity, with that of a wind which pulls all hair alike [m/s^2].
    """

    name = "gravity"
    equation = "Eq. 9"
    metric_unit = "mm"
    acceleration: Acceleration = GRAVITY

    def __post_init__(self) -> None:
        check_acceleration(self.acceleration)

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return energy_gravity_above_root(hair.positions, hair.rest.mass, self.acceleration)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s n"]:
        """Height of every vertex above its root [mm]."""
        return 1000 * (hair.positions - hair.positions[:, :, :1])[..., 2]
