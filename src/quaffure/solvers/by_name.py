"""Every draper that needs no weights, by name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

from quaffure.baselines.posed import PosedDraper
from quaffure.config import HairMaterial
from quaffure.draper import Draper, LoadDependentDraper, StoppingReport
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.energy_term import Terms
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.errors import InputError
from quaffure.scene import Scene
from quaffure.solvers.adam import AdamDraper, AdamPositionsDraper
from quaffure.solvers.lbfgs import LbfgsDraper, LbfgsPositionsDraper
from quaffure.solvers.strand_newton import StrandNewtonDraper
from quaffure.solvers.xpbd import PaperXpbdDraper, XpbdDraper
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


_OF_TERMS = (AdamDraper, AdamPositionsDraper, LbfgsDraper, LbfgsPositionsDraper, XpbdDraper)
_DRAPERS: dict[str, Callable[[HairMaterial, Terms | None], Draper]] = {
    **{kind.name: _with_terms(kind) for kind in (StrandNewtonDraper, *_OF_TERMS, PaperXpbdDraper)},
    PosedDraper.name: lambda material, terms: PosedDraper(material),
}
SOLVERS = tuple(_DRAPERS)


def solver(name: str, material: HairMaterial | None = None, terms: Terms | None = None) -> Draper:
    """The draper of that name with its default setting.

    Args:
        terms: of the energy (`quaffure.energies.by_name`); where none are given, those of the sag-free rod of every
            groom that is draped (`DesignSolver`), for `xpbd_paper` Eqs. 6, 7, 9, 10 and 11.

    Raises:
        InputError: no draper of that name, or one that does not accept these terms.
    """
    if name not in _DRAPERS:
        raise InputError("draper", f"one of {', '.join(SOLVERS)}", repr(name))
    if terms is None and any(name == kind.name for kind in _OF_TERMS):
        return DesignSolver(name, material or HairMaterial())
    return _DRAPERS[name](material or HairMaterial(), terms)


@dataclass(frozen=True)
class DesignSolver:
    """The solver of a name on the energy of the sag-free rod: a groom's rest shape is found when it is draped.

    Attributes:
        name: one of `SOLVERS`.
        loading: stiffness, gravity and wind.
        start: whose drape the solver starts from; where there is none, the solver's own start.
    """

    name: str
    material: HairMaterial
    loading: Loading = STANDARD_LOADING
    start: LoadDependentDraper | None = None

    def with_loading(self, loading: Loading) -> "DesignSolver":
        """The same solver under another loading."""
        return replace(self, loading=loading, start=self.start and self.start.with_loading(loading))

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world].

        Raises:
            InputError: a solver without the rod, or one that cannot start from a drape where it shall.
        """
        terms = terms_of_design(scene.groom, scene.bodies.body, self.material, self.loading)
        draper = solver(self.name, self.material, terms)
        if self.start is None:
            return draper.drape(scene)
        if not isinstance(draper, StartedSolver):
            raise InputError("solver", "one that can start from a drape", self.name)
        return draper.drape_from(scene, self.start.drape(scene))
