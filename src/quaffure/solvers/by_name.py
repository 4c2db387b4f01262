"""Every draper that needs no weights, by name."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from quaffure.baselines.posed import PosedDraper
from quaffure.config import HairMaterial
from quaffure.draper import Draper, StoppingReport
from quaffure.energies.hair_terms import MODIFIED_COSSERAT, hair_terms
from quaffure.energies.sag_free import SagFreeRest
from quaffure.errors import InputError
from quaffure.scene import Scene
from quaffure.solvers.adam import AdamDraper, AdamPositionsDraper
from quaffure.solvers.lbfgs import LbfgsDraper, LbfgsPositionsDraper
from quaffure.solvers.newton.newton import NewtonDraper
from quaffure.solvers.xpbd import XpbdDraper, paper_setting
from quaffure.types import Positions


@runtime_checkable
class Solver(Draper, Protocol):
    """A draper that reports where it stopped."""

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        ...


_CLASSES = (AdamDraper, AdamPositionsDraper, LbfgsDraper, LbfgsPositionsDraper)
DESCENTS = {draper.name: draper for draper in _CLASSES}
"""Solvers that use gradients alone and so accept every energy term."""

MODIFIED_ONLY: dict[str, Callable[[HairMaterial], Draper]] = {
    "newton": NewtonDraper,
    "xpbd": XpbdDraper,
    "xpbd_paper": lambda material: XpbdDraper(material, paper_setting()),
    "posed": PosedDraper,
}
"""Drapers for the modified Cosserat model alone."""

SOLVERS = (*DESCENTS, *MODIFIED_ONLY)


def solver(
    name: str,
    material: HairMaterial | None = None,
    elastic: str = MODIFIED_COSSERAT,
    design: SagFreeRest | None = None,
) -> Draper:
    """The draper of that name with its default setting.

    Args:
        elastic: name of the elastic model (`quaffure.energies.hair_terms`).
        design: sag-free rest shape of the one groom to drape, with the rod alone.

    Raises:
        InputError: no draper or elastic model of that name, or a draper that does not accept that model.
    """
    material = material or HairMaterial()
    terms = hair_terms(elastic, design)
    if name in DESCENTS:
        return DESCENTS[name](material, terms=terms)
    if name not in MODIFIED_ONLY:
        raise InputError("draper", f"one of {', '.join(SOLVERS)}", repr(name))
    if elastic != MODIFIED_COSSERAT:
        raise InputError(f"elastic model {elastic}", f"one of the drapers {', '.join(DESCENTS)}", name)
    return MODIFIED_ONLY[name](material)
