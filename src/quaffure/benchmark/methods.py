"""The methods that are compared: one row a draper, all on the same hair."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from quaffure.baselines.groomgen import GroomGenDraper
from quaffure.baselines.posed import PosedDraper
from quaffure.body.body_model import BodyModel
from quaffure.draper import Draper, LoadDependentDraper
from quaffure.drapers import GROOMGEN, NEURAL, POSED, STRAND_NEWTON, load_trained, reads_loading
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.model.quaffure_model import PAPER, load_model
from quaffure.solvers.by_name import DesignSolver
from quaffure.solvers.strand_newton import with_settling

SETTLED = f"{NEURAL}_settled"
STARTED_ROWS = ("adam", "lbfgs", STRAND_NEWTON)
SOLVER_ROWS = (*STARTED_ROWS, "xpbd")
FROM_NETWORK = {f"{name}_from_{NEURAL}": name for name in STARTED_ROWS}
"""Solvers that start from the network's drape instead of their own start. The lowest drape of a frame among these rows
and `SOLVER_ROWS` is the reference of all rows."""
ROWS = (POSED, *SOLVER_ROWS, *FROM_NETWORK, NEURAL, SETTLED, PAPER)
QUICK_ROWS = (POSED, STRAND_NEWTON, NEURAL, SETTLED)


@dataclass(frozen=True, eq=False)
class Method:
    """A row of the comparison.

    Attributes:
        is_solver: whether its drapes may be the reference.
        notes: how its weights were made.
    """

    name: str
    draper: Draper
    is_solver: bool = False
    notes: dict[str, str] = field(default_factory=dict)

    def drapes(self, groom: Groom, body: BodyModel, loading: Loading) -> bool:
        """Whether it can drape this groom under a loading: GroomGen drapes only its own, and it and the paper's
        configuration know one loading."""
        if isinstance(self.draper, GroomGenDraper) and not self.draper.knows(groom, body):
            return False
        if loading == STANDARD_LOADING:
            return True
        return reads_loading(self.draper)

    def with_loading(self, loading: Loading) -> Draper:
        """The draper under a loading that it knows."""
        if loading == STANDARD_LOADING:
            return self.draper
        assert isinstance(self.draper, LoadDependentDraper)
        return self.draper.with_loading(loading)


def methods(names: Sequence[str], weights: Mapping[str, Path]) -> list[Method]:
    """The chosen rows, in that order and each once.

    All rows but `paper`, whose elastic model is another, drape the hair of the row `neural`: that of the shipped
    weights, or of those that replace them.

    Args:
        names: of `ROWS` or of `weights`.
        weights: checkpoints by the name of their row; `neural` replaces the shipped ones, `groomgen` is the baseline.

    Raises:
        InputError: a name that is no row, a file that is no checkpoint, or one that was trained for other hair.
    """
    rows = _shipped_rows(weights.get(NEURAL), with_paper=PAPER in names and PAPER not in weights)
    material = rows[NEURAL].draper.material
    for name, path in weights.items():
        if name == NEURAL:
            continue
        if name in rows or not re.fullmatch(r"\w[\w.-]*", name):
            raise InputError(f"weights '{name}={path}'", f"another name than {', '.join(rows)}", f"'{name}'")
        draper, notes = load_trained(name, path)
        if draper.material != material:
            raise InputError(path, f"weights for hair of {material}, as all rows", f"{draper.material}")
        rows[name] = Method(name, draper, notes=notes)
    for name in names:
        if name == GROOMGEN and name not in rows:
            raise InputError(f"draper {name}", f"--weights {name}=FILE with it: none are shipped", "none")
        if name not in rows:
            raise InputError("draper", f"one of {', '.join(rows)}", f"'{name}'")
    return [rows[name] for name in dict.fromkeys(names)]


def _shipped_rows(weights: Path | None, with_paper: bool) -> dict[str, Method]:
    """The rows that need no weights of the user, by name.

    Args:
        weights: instead of the shipped ones.
        with_paper: the paper's configuration too, whose weights take a moment to read.
    """
    shipped = load_model(weights)
    material = shipped.draper.material
    rows = [
        Method(POSED, PosedDraper(material)),
        Method(NEURAL, shipped.draper, notes=shipped.notes),
        Method(SETTLED, with_settling(shipped.draper), notes=shipped.notes),
    ]
    rows += [Method(name, DesignSolver(name, material), is_solver=True) for name in SOLVER_ROWS]
    rows += [
        Method(name, DesignSolver(solver, material, start=shipped.draper), is_solver=True)
        for name, solver in FROM_NETWORK.items()
    ]
    if with_paper:
        published = load_model(PAPER)
        rows.append(Method(PAPER, published.draper, notes=published.notes))
    return {row.name: row for row in rows}
