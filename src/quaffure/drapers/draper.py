"""What every way of draping answers to."""

from dataclasses import dataclass
from typing import Protocol

from quaffure.drapers.scene import Scene
from quaffure.types import Positions


class Draper(Protocol):
    """Settles a groom on posed bodies."""

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world]."""
        ...


@dataclass(frozen=True)
class StoppingReport:
    """Where an iterative draper stopped, per batch.

    Attributes:
        energy: mean energy of the samples [J].
        relative_gradient: norm of the gradient over that at the start.
        iterations: energy evaluations.
        seconds: wall time.
    """

    energy: float
    relative_gradient: float
    iterations: int
    seconds: float
