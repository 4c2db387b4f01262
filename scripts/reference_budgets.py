"""How much lower the reference of the evaluation would be with twice every solver's budget.

    python scripts/reference_budgets.py --motion-folder DIR ... --groom-folder DIR ...

One frame of every `--every`-th case of the current set. Energies in m g L per vertex above the lowest of all that were
found; 'strand_newton' is the lowest of its rows alone, which are the reference where the slow solvers are not run.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import tyro

from quaffure.benchmark.evaluation_set import DataFolders, EvaluationCase, load_cases, load_evaluation_set
from quaffure.body import BodyModel, load_body
from quaffure.energies import HairEnergy
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.energy_term import Terms
from quaffure.model import load_model
from quaffure.model.neural import NeuralDraper
from quaffure.scene import Scene
from quaffure.solvers import AdamDraper, LbfgsDraper, StrandNewtonDraper, StrandNewtonSetting, XpbdDraper
from quaffure.solvers.by_name import Solver, StartedSolver
from quaffure.solvers.xpbd import XpbdSetting

COLUMNS = ("case", "strand_newton", "all solvers", "of", "twice the budgets", "of")


def main(motion_folder: tuple[Path, ...], groom_folder: tuple[Path, ...], every: int = 7) -> None:
    body, network = load_body(), load_model().draper
    evaluation_set, folders = load_evaluation_set(), DataFolders(motion_folder, groom_folder)
    entries = [entry for entry in evaluation_set.cases[::every] if folders.missing(entry, evaluation_set) is None]
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|")
    rows = []
    for case in load_cases(entries, evaluation_set, folders, body):
        scene = Scene(case.groom, case.bodies(body, 0))
        rows.append(_row(case, scene, body, network.with_loading(case.loading)))
    means = [sum(column) / len(rows) for column in zip(*rows)]
    print(f"| mean | {means[0]:.4f} | {means[1]:.4f} | | {means[2]:.4f} | |")


def _row(case: EvaluationCase, scene: Scene, body: BodyModel, network: NeuralDraper) -> tuple[float, float, float]:
    """Print the row of a case; its lowest energies by `strand_newton`, by all solvers, and with twice the budgets."""
    terms = terms_of_design(case.groom, body, network.material, case.loading)
    energy, start = HairEnergy(case.groom, network.material, terms), network.drape(scene)
    found: list[dict[str, float]] = []
    for factor in (1, 2):
        drapes = {}
        for solver in _solvers(network, terms, factor):
            drapes[solver.name] = solver.drape(scene)
            if isinstance(solver, StartedSolver):
                drapes[f"{solver.name}_from_neural"] = solver.drape_from(scene, start)
        found.append({name: float(energy.per_vertex(energy.total(hair, scene))) for name, hair in drapes.items()})
    once, twice = found
    fast = min(value for name, value in once.items() if name.startswith(StrandNewtonDraper.name))
    lowest = min(*once.values(), *twice.values())
    above = fast - lowest, min(once.values()) - lowest, min(twice.values()) - lowest
    best = [min(energies, key=energies.__getitem__) for energies in found]
    print(f"| {case.name} | {above[0]:.4f} | {above[1]:.4f} | {best[0]} | {above[2]:.4f} | {best[1]} |", flush=True)
    return above


def _solvers(network: NeuralDraper, terms: Terms, factor: int) -> Iterator[Solver]:
    """The solvers of the evaluation, with that many times their budgets."""
    material, passes, steps = network.material, StrandNewtonSetting().passes, XpbdSetting().steps
    yield StrandNewtonDraper(material, StrandNewtonSetting(passes=factor * passes), terms=terms)
    yield AdamDraper(material, factor * AdamDraper(material).steps, terms=terms)
    yield LbfgsDraper(material, factor * LbfgsDraper(material).evaluations, terms=terms)
    yield XpbdDraper(material, replace(XpbdSetting(), steps=factor * steps), terms=terms)


if __name__ == "__main__":
    tyro.cli(main)
