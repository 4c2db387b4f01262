"""What the shape of hair depends on besides groom, pose and body: its stiffness, gravity and wind."""

from dataclasses import dataclass
from functools import cached_property

import torch

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.gravity import GRAVITY, Acceleration, check_acceleration
from quaffure.energies.rod import check_stiffness
from quaffure.types import Float, Tensor


@dataclass(frozen=True, eq=False)
class Loading:
    """Stiffness and acceleration, the same for all strands but where a stiffness for each edge is given.

    Attributes:
        stiffness: multiple of the rod's bending and twisting stiffness, of all edges or of each [s e]; 0.3 to 3 is that
            of human hair.
        acceleration: of gravity, multiplied by the hair's weight, and wind, along the world's axes, z up [m/s^2].
    """

    stiffness: float | Float[Tensor, "s e"] = 1.0
    acceleration: Acceleration = GRAVITY

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Loading) or self.acceleration != other.acceleration:
            return False
        return torch.equal(torch.as_tensor(self.stiffness).cpu(), torch.as_tensor(other.stiffness).cpu())

    def __hash__(self) -> int:
        return hash(self.acceleration)

    def check(self) -> None:
        """Refuse what no hair has.

        Raises:
            InputError: what `check_stiffness` or `check_acceleration` refuses.
        """
        check_stiffness(self.stiffness)
        check_acceleration(self.acceleration)

    @cached_property
    def mean_stiffness(self) -> float:
        """Geometric mean over the edges."""
        if isinstance(self.stiffness, Tensor):
            return float(self.stiffness.log().mean().exp())
        return self.stiffness

    @cached_property
    def in_gravities(self) -> tuple[float, float, float]:
        """The acceleration in g."""
        x, y, z = self.acceleration
        return x / STANDARD_GRAVITY, y / STANDARD_GRAVITY, z / STANDARD_GRAVITY


STANDARD_LOADING = Loading()
"""Human hair under gravity."""
