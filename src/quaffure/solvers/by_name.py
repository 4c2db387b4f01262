"""Every draper that needs no weights, by name."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from quaffure.baselines.posed import PosedDraper
from quaffure.config import HairMaterial
from quaffure.draper import Draper, StoppingReport
from quaffure.energies.elastic_model import ModifiedCosserat, elastic_model
from quaffure.errors import InputError
from quaffure.scene import Scene
from quaffure.solvers.adam import AdamDraper, AdamPositionsDraper
from quaffure.solvers.lbfgs import LbfgsDraper, LbfgsPositionsDraper
from quaffure.solvers.newton.newton import NewtonDraper
from quaffure.solvers.xpbd import XpbdDraper, paper_setting
from quaffure.types import Positions


@runtime_checkable
class Solver(Draper, Protocol):
    """A draper that says where it stopped."""

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        ...


DESCENTS: dict[str, Callable[[HairMaterial, str], Solver]] = {
    "adam": lambda material, elastic: AdamDraper(material, elastic=elastic),
    "adam_positions": lambda material, elastic: AdamPositionsDraper(material, elastic=elastic),
    "lbfgs": lambda material, elastic: LbfgsDraper(material, elastic=elastic),
    "lbfgs_positions": lambda material, elastic: LbfgsPositionsDraper(material, elastic=elastic),
}
"""Solvers that need gradients alone and so take every elastic model."""

MODIFIED_ONLY: dict[str, Callable[[HairMaterial], Draper]] = {
    "newton": NewtonDraper,
    "xpbd": XpbdDraper,
    "xpbd_paper": lambda material: XpbdDraper(material, paper_setting()),
    "posed": PosedDraper,
}
"""Drapers that are made for the modified Cosserat model."""

SOLVERS = (*DESCENTS, *MODIFIED_ONLY)


def solver(name: str, material: HairMaterial | None = None, elastic: str = ModifiedCosserat.name) -> Draper:
    """The draper of that name with its default setting.

    Args:
        elastic: name of the elastic model (`quaffure.energies.elastic_model`).

    Raises:
        InputError: no draper or elastic model of that name, or a draper that does not take that model.
    """
    material = material or HairMaterial()
    elastic_model(elastic)
    if name in DESCENTS:
        return DESCENTS[name](material, elastic)
    if name not in MODIFIED_ONLY:
        raise InputError("draper", f"one of {', '.join(SOLVERS)}", repr(name))
    if elastic != ModifiedCosserat.name:
        raise InputError(f"elastic model {elastic}", f"one of the drapers {', '.join(DESCENTS)}", name)
    return MODIFIED_ONLY[name](material)
