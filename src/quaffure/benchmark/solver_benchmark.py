"""Energy against time: every solver on the same drapes, each with several budgets.

A budget is a run of its own and not a pause of a longer one, since Adam's learning rate and XPBD's time steps follow
schedules that end with the run.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version

from quaffure.baselines.posed import PosedDraper
from quaffure.benchmark.machine_facts import machine_facts
from quaffure.benchmark.metrics import metrics
from quaffure.config import HairMaterial
from quaffure.draper import Draper
from quaffure.energies.by_name import ROD, hair_terms
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.energy_term import Terms
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import Scene
from quaffure.solvers.adam import AdamDraper, AdamPositionsDraper
from quaffure.solvers.by_name import Solver
from quaffure.solvers.lbfgs import LbfgsDraper, LbfgsPositionsDraper
from quaffure.solvers.stopping import energy_and_gradient, relative_gradient
from quaffure.solvers.strand_newton import StrandNewtonDraper, StrandNewtonSetting
from quaffure.solvers.xpbd import PaperXpbdDraper, XpbdDraper, XpbdSetting, paper_setting
from quaffure.types import Positions

PAPER = PaperXpbdDraper.name
PAPER_STEPS = 2
"""Steps that are measured of the paper's 30; the time of all is extrapolated."""


@dataclass(frozen=True)
class Case:
    """One drape to find.

    Attributes:
        scene: of one sample.
    """

    name: str
    scene: Scene


@dataclass(frozen=True)
class Budget:
    """A solver with a limit on its work.

    Attributes:
        effort: steps or evaluations, in the solver's own unit.
        share: part of the whole setting that this run is; below 1 the whole one's time is extrapolated.
    """

    solver: str
    effort: int
    draper: Callable[[HairMaterial, Terms], Draper]
    share: float = 1.0


@dataclass(frozen=True)
class Run:
    """What one budget reached on one case. Energies in m g L per vertex, see `docs/metrics.md`.

    Attributes:
        excess_energy: above the least energy that any run reached on the case.
        relative_gradient: `quaffure.solvers.stopping`, the same measure for all.
        iterations: of the solver's `StoppingReport`, over `share` of the run; None without a report.
        seconds, cpu_seconds: wall and processor time of the whole setting, measured over `share` of it.
    """

    case: str
    solver: str
    effort: int
    energy: float
    excess_energy: float
    relative_gradient: float
    iterations: int | None
    body_intersection_percent: float
    length_error_percent: float
    density_excess_percent: float
    seconds: float
    cpu_seconds: float
    share: float


def budgets(elastic: str = ROD, quick: bool = False) -> list[Budget]:
    """The solvers of the benchmark with their budgets; `quick` runs show that everything works and little else.

    Args:
        elastic: the elastic model; `strand_newton` minimizes the rod alone, and the paper's setting of XPBD is for its
            own.
    """
    efforts = _QUICK if quick else _WHOLE
    every = [Budget("posed", 0, lambda material, terms: PosedDraper(material))]
    for name, many in efforts.items():
        if name != StrandNewtonDraper.name or elastic == ROD:
            every += [Budget(name, effort, _WITH_EFFORT[name](effort)) for effort in many]
    if quick or elastic == ROD:
        return every
    part = replace(paper_setting(), steps=PAPER_STEPS)
    share = PAPER_STEPS / paper_setting().steps
    return [*every, Budget(PAPER, PAPER_STEPS, lambda material, terms: XpbdDraper(material, part, terms), share)]


def run_benchmark(
    cases: Sequence[Case],
    chosen: Sequence[Budget],
    elastic: str = ROD,
    on_run: Callable[[str], None] = lambda label: None,
) -> list[Run]:
    """Every budget on every case.

    Args:
        elastic: the elastic model; the rod rests in the groom's design.
        on_run: called with what is about to run.

    Raises:
        InputError: a solver that does not minimize this model.
    """
    material = HairMaterial()
    _compile(cases[0], chosen, _energy_of(cases[0].scene, elastic, material))
    runs: list[Run] = []
    for case in cases:
        energy = _energy_of(case.scene, elastic, material)
        _ = case.scene.director, case.scene.surface, energy.rest.rest_density  # made before the clock starts
        of_case = []
        for budget in chosen:
            on_run(f"{budget.solver} {budget.effort or ''} on {case.name}")
            of_case.append(_run(case, budget, budget.draper(material, energy.terms), energy))
        least = min(run.energy for run in of_case)
        runs += [replace(run, excess_energy=run.energy - least) for run in of_case]
    return runs


def report(runs: Sequence[Run], chosen: Sequence[Budget]) -> dict[str, object]:
    """What `bench.json` holds."""
    return {
        "version": version("quaffure"),
        "machine": machine_facts(),
        "extrapolated": sorted({budget.solver for budget in chosen if budget.share < 1}),
        "runs": [asdict(run) for run in runs],
    }


def _energy_of(scene: Scene, elastic: str, material: HairMaterial) -> HairEnergy:
    is_rod = elastic == ROD
    terms = terms_of_design(scene.groom, scene.bodies.body, material) if is_rod else hair_terms(elastic)
    return HairEnergy(scene.groom, material, terms)


def _run(case: Case, budget: Budget, draper: Draper, energy: HairEnergy) -> Run:
    wall, processor = time.perf_counter(), time.process_time()
    draped, stopped = draper.solve(case.scene) if isinstance(draper, Solver) else (draper.drape(case.scene), None)
    seconds, cpu_seconds = time.perf_counter() - wall, time.process_time() - processor
    draped = draped.detach()
    values = {name: float(value) for name, value in metrics(draped, case.scene, energy).items()}
    return Run(
        case=case.name,
        solver=budget.solver,
        effort=budget.effort,
        energy=values["energy"],
        excess_energy=0.0,
        relative_gradient=_residual(draped, case.scene, energy),
        iterations=None if stopped is None else stopped.iterations,
        body_intersection_percent=values["body_intersection_percent"],
        length_error_percent=values["length_error_percent"],
        density_excess_percent=values["density_excess_percent"],
        seconds=seconds / budget.share,
        cpu_seconds=cpu_seconds / budget.share,
        share=budget.share,
    )


def _residual(draped: Positions, scene: Scene, energy: HairEnergy) -> float:
    gradient = energy_and_gradient(energy, scene, draped)[1]
    return float(relative_gradient(energy, draped, gradient))


def _compile(case: Case, chosen: Sequence[Budget], energy: HairEnergy) -> None:
    """Run every solver once, as briefly as it can, so that no time includes the compiler.

    On the whole groom: a few strands touch no others, and the kernels of hair against hair would not be compiled.
    """
    for name in {budget.solver for budget in chosen}:
        kind = XpbdDraper.name if name == PAPER else name
        if kind in _WITH_EFFORT:
            shortest = _QUICK[kind][0] if kind == StrandNewtonDraper.name else 1
            _WITH_EFFORT[kind](shortest)(energy.material, energy.terms).drape(case.scene)


_WITH_EFFORT: dict[str, Callable[[int], Callable[[HairMaterial, Terms], Draper]]] = {
    "strand_newton": lambda effort: (
        lambda material, terms: StrandNewtonDraper(material, StrandNewtonSetting(passes=effort), terms)
    ),
    "adam": lambda effort: lambda material, terms: AdamDraper(material, steps=effort, terms=terms),
    "adam_positions": lambda effort: lambda material, terms: AdamPositionsDraper(material, steps=effort, terms=terms),
    "lbfgs": lambda effort: lambda material, terms: LbfgsDraper(material, evaluations=effort, terms=terms),
    "lbfgs_positions": lambda effort: (
        lambda material, terms: LbfgsPositionsDraper(material, evaluations=effort, terms=terms)
    ),
    "xpbd": lambda effort: lambda material, terms: XpbdDraper(material, XpbdSetting(steps=effort), terms),
}
_WHOLE = {
    "strand_newton": (8, 12, 20, 40),
    "adam": (100, 300, 1000),
    "adam_positions": (300, 1000, 3000),
    "lbfgs": (100, 300, 1000),
    "lbfgs_positions": (300, 1000, 3000),
    "xpbd": (25, 50, 100, 200),
}
_QUICK = {
    "strand_newton": (8, 12),
    "adam": (20, 60),
    "adam_positions": (60,),
    "lbfgs": (20, 60),
    "lbfgs_positions": (60,),
    "xpbd": (10, 30),
}
