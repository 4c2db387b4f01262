"""Every draper that needs no weights, by name."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from quaffure.baselines.posed import PosedDraper
from quaffure.config import HairMaterial
from quaffure.draper import Draper, StoppingReport
from quaffure.energies.energy_term import Terms
from quaffure.errors import InputError
from quaffure.scene import Scene
from quaffure.solvers.adam import AdamDraper, AdamPositionsDraper
from quaffure.solvers.lbfgs import LbfgsDraper, LbfgsPositionsDraper
from quaffure.solvers.strand_newton import StrandNewtonDraper
from quaffure.solvers.xpbd import XpbdDraper, paper_setting
from quaffure.types import Positions


@runtime_checkable
class Solver(Draper, Protocol):
    """A draper that reports where it stopped."""

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        ...


@runtime_checkable
class StartedSolver(Solver, Protocol):
    """A solver that can start from any drape."""

    def drape_from(self, scene: Scene, start: Positions) -> Positions:
        """Draped vertices [m] from any drape of the scene."""
        ...


def _with_terms(kind: Callable[..., Draper]) -> Callable[[HairMaterial, Terms | None], Draper]:
    return lambda material, terms: kind(material, terms=terms)


_CLASSES = (StrandNewtonDraper, AdamDraper, AdamPositionsDraper, LbfgsDraper, LbfgsPositionsDraper, XpbdDraper)
_DRAPERS: dict[str, Callable[[HairMaterial, Terms | None], Draper]] = {
    **{kind.name: _with_terms(kind) for kind in _CLASSES},
    "xpbd_paper": lambda material, terms: XpbdDraper(material, paper_setting(), terms),
    PosedDraper.name: lambda material, terms: PosedDraper(material),
}
SOLVERS = tuple(_DRAPERS)


def solver(name: str, material: HairMaterial | None = None, terms: Terms | None = None) -> Draper:
    """The draper of that name with its default setting.

    Args:
        terms: of the energy (`quaffure.energies.by_name`); where none are given, those of the sag-free rod for
            `strand_newton`, Eqs. 6, 7, 9, 10 and 11 for the others.

    Raises:
        InputError: no draper of that name, or one that does not accept these terms.
    """
    if name not in _DRAPERS:
        raise InputError("draper", f"one of {', '.join(SOLVERS)}", repr(name))
    return _DRAPERS[name](material or HairMaterial(), terms)
