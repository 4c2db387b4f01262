"""The comparison: every competitor on every case, measured by the same code. See docs/evaluation.md."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, median

import torch

from quaffure.benchmark.drape_cache import TimedDrape
from quaffure.benchmark.evaluation_set import EvaluationCase
from quaffure.benchmark.metrics import acceleration_from_head, metrics
from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import Scene

Figures = dict[str, list[float]]
"""Values by name of the figure of merit: one a frame, or one for the case."""
Summary = dict[str, dict[str, dict[str, dict[str, float]]]]
"""By group of cases, row and figure: `mean` and `worst`, of times `median` and `worst`."""
DrapeFrame = Callable[[EvaluationCase, int], TimedDrape | None]
"""Makes or fetches the drape of a frame, counted within the case."""
TIME = "milliseconds"


@dataclass(frozen=True)
class CaseResult:
    """What became of one case.

    Attributes:
        frames: of the clip.
        reference: the solver whose drape was the lowest, by frame; empty where no solver had a drape.
        figures: by row.
    """

    case: str
    group: str
    groom: str
    clip: str
    shape: str
    frames: tuple[int, ...]
    reference: tuple[str, ...]
    figures: dict[str, Figures]
    machines: tuple[str, ...]


def compare(
    cases: Iterable[EvaluationCase],
    rows: Mapping[str, DrapeFrame],
    solvers: Collection[str],
    body: BodyModel,
    material: HairMaterial,
) -> list[CaseResult]:
    """Every row on every case.

    Args:
        rows: drapers by name; one that has no drape of some frame of a case is left out of that case.
        solvers: the rows of which the lowest drape of a frame is the reference.
        material: of all rows' hair.
    """
    results = []
    for case in cases:
        drapes: dict[str, list[TimedDrape]] = {}
        for name, drape_frame in rows.items():
            frames = [drape_frame(case, frame) for frame in range(len(case.frames))]
            whole = [frame for frame in frames if frame is not None]
            if len(whole) == len(frames):
                drapes[name] = whole
        results.append(measure_case(case, drapes, [name for name in drapes if name in solvers], body, material))
    return results


def measure_case(
    case: EvaluationCase,
    drapes: dict[str, list[TimedDrape]],
    solvers: Sequence[str],
    body: BodyModel,
    material: HairMaterial,
) -> CaseResult:
    """All figures of merit of a case's drapes, those against the reference where a solver has draped it."""
    energy = HairEnergy(case.groom, material)
    figures: dict[str, Figures] = {name: {} for name in drapes}
    reference = []
    for frame in range(len(case.frames)):
        scene = Scene(case.groom, case.bodies(body, frame))
        strands = {name: frames[frame].strands for name, frames in drapes.items()}
        of_frame = {
            name: {key: float(value) for key, value in metrics(draped[None], scene, energy).items()}
            for name, draped in strands.items()
        }
        if solvers:
            best = min(solvers, key=lambda name: of_frame[name]["energy"])
            reference.append(best)
            for name, own in of_frame.items():
                own["excess_energy"] = own["energy"] - of_frame[best]["energy"]
                own["distance_mm"] = 1000 * float((strands[name] - strands[best]).norm(dim=-1).mean())
        for name, own in of_frame.items():
            for key, value in own.items():
                figures[name].setdefault(key, []).append(value)
    _add_jitter(figures, case, drapes, solvers, body)
    _add_times(figures, drapes)
    return CaseResult(
        case=case.name,
        group=case.group,
        groom=case.groom.name,
        clip=case.motion.name,
        shape=case.shape,
        frames=case.frames,
        reference=tuple(reference),
        figures=figures,
        machines=tuple(sorted({frame.machine for frames in drapes.values() for frame in frames if frame.machine})),
    )


def summarize(results: Sequence[CaseResult]) -> Summary:
    """Figures over all cases, over each group and over each clip.

    The mean is that of the cases, each the mean of its frames, so that a run weighs no more than a frame; the worst is
    the worst frame. A row that misses a case of a group is left out there.
    """
    groups: dict[str, list[CaseResult]] = {"all": list(results)}
    for result in results:
        groups.setdefault(result.group, []).append(result)
    for result in results:
        groups.setdefault(f"clip {result.clip}", []).append(result)
    return {group: _of_group(of_group) for group, of_group in groups.items()}


def _of_group(results: Sequence[CaseResult]) -> dict[str, dict[str, dict[str, float]]]:
    rows = [name for name in results[0].figures if all(name in result.figures for result in results)] if results else []
    summary: dict[str, dict[str, dict[str, float]]] = {}
    for row in rows:
        own = [result.figures[row] for result in results]
        summary[row] = {}
        for key in dict.fromkeys(key for figures in own for key in figures):
            cases = [figures[key] for figures in own if key in figures]
            every = [value for case in cases for value in case]
            middle = {"median": median(every)} if key == TIME else {"mean": mean(mean(case) for case in cases)}
            summary[row][key] = middle | {"worst": max(every)}
    return summary


def _add_jitter(
    figures: dict[str, Figures],
    case: EvaluationCase,
    drapes: dict[str, list[TimedDrape]],
    solvers: Sequence[str],
    body: BodyModel,
) -> None:
    """Relative to the one solver that is lowest over the run: a reference that changes between frames would tremble."""
    if not solvers or not case.is_run:
        return
    bodies = case.bodies(body)
    trembling = {
        name: float(acceleration_from_head(torch.stack([frame.strands for frame in frames]), bodies))
        for name, frames in drapes.items()
    }
    best = min(solvers, key=lambda name: mean(figures[name]["energy"]))
    if trembling[best] == 0:
        return  # nothing moves: no ratio
    for name, value in trembling.items():
        figures[name]["jitter"] = [value / trembling[best]]


def _add_times(figures: dict[str, Figures], drapes: dict[str, list[TimedDrape]]) -> None:
    for name, frames in drapes.items():
        times = [frame.milliseconds for frame in frames if frame.milliseconds is not None]
        if times:
            figures[name][TIME] = times
