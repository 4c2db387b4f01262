"""Every draper by its name: one list for the command line, comparisons, the live page and tables of characters.

Solvers that need no weights are made by `quaffure.solvers.by_name`; here the drapers that were trained join them.
"""

from pathlib import Path

from quaffure.baselines.groomgen import GroomGenDraper, load_groomgen
from quaffure.baselines.posed import PosedDraper
from quaffure.config import HairMaterial
from quaffure.draper import Draper, LoadDependentDraper
from quaffure.energies.by_name import MODIFIED_COSSERAT, ROD
from quaffure.errors import InputError
from quaffure.model.neural import NeuralDraper
from quaffure.model.quaffure_model import PAPER, load_model
from quaffure.solvers.by_name import SOLVERS, solver
from quaffure.solvers.coherent_clip import CoherentDraper
from quaffure.solvers.strand_newton import StrandNewtonDraper
from quaffure.solvers.xpbd import PaperXpbdDraper

POSED, NEURAL, GROOMGEN = PosedDraper.name, NeuralDraper.name, GroomGenDraper.name
STRAND_NEWTON = StrandNewtonDraper.name
DRAPERS = (*SOLVERS, NEURAL, GROOMGEN)
LIVE_DRAPERS = (NEURAL, STRAND_NEWTON, POSED)
"""Drapers that follow every change; all others take seconds to minutes, or need weights of the user."""


def elastic_model_of(name: str, model: str | None = None) -> str:
    """The elastic model that a draper minimizes where no other is asked for, or that its weights were trained on: the
    paper's or the rod.

    Args:
        name: one of `DRAPERS`.
        model: shipped weights by their name (`quaffure.model.MODELS`).
    """
    return MODIFIED_COSSERAT if name in (PaperXpbdDraper.name, GROOMGEN) or model == PAPER else ROD


def load_trained(name: str, weights: str | Path | None = None) -> tuple[Draper, dict[str, str]]:
    """A draper of a training run, and how its weights were made.

    Args:
        name: `groomgen`, whose weights are none of the package's; a network under any other name.
        weights: a file, or a name of shipped weights; without it, the shipped network.

    Raises:
        InputError: `weights` holds no such draper.
    """
    if name == GROOMGEN:
        if weights is None:
            raise InputError(f"draper {name}", "the file of its weights: none are shipped", "none")
        return load_groomgen(weights)
    model = load_model(weights)
    return model.draper, model.notes


def reads_loading(draper: Draper) -> bool:
    """Whether a draper, and the one that it starts from, knows other loadings than the standard one."""
    if isinstance(draper, NeuralDraper):
        return draper.reads_loading
    start: Draper | None = getattr(draper, "start", None)
    return isinstance(draper, LoadDependentDraper) and (start is None or reads_loading(start))


def make_draper(name: str, material: HairMaterial | None = None) -> Draper:
    """A draper that needs no weights of the user: the shipped network or a solver.

    Args:
        name: one of `DRAPERS`.
        material: of a solver; a trained draper has its own.

    Raises:
        InputError: no such draper, one whose weights are the user's.
    """
    if name in (NEURAL, GROOMGEN):
        if material is not None:
            raise InputError(f"draper {name}", "no material: it has that of its training", "one")
        return load_trained(name)[0]
    return solver(name, material)


def with_coherence(draper: Draper) -> Draper:
    """The draper whose frames follow from the last one, where it can do that; else the same."""
    return CoherentDraper(draper) if isinstance(draper, StrandNewtonDraper) else draper
