"""The comparison: every method on every case, measured by the same code. See docs/evaluation.md."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, median

import torch

from quaffure.benchmark.drape_cache import TimedDrape
from quaffure.benchmark.evaluation_set import EvaluationCase
from quaffure.benchmark.metrics import accelerations, metrics, vertices_from_head
from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import Scene
from quaffure.types import Positions

Metrics = dict[str, list[float]]
"""Values by name of the metric: one a frame, or one for the case."""
Summary = dict[str, dict[str, dict[str, dict[str, float]]]]
"""By group of cases, row and metric: `mean` and `worst`, of times `median` and `worst`."""
DrapeFrame = Callable[[EvaluationCase, int], TimedDrape | None]
"""Makes or fetches the drape of a frame, counted within the case."""
TIME = "milliseconds"


@dataclass(frozen=True)
class CaseResult:
    """Metrics of one case.

    Attributes:
        frames: of the clip.
        reference: the solver whose drape was the lowest, by frame; empty where no solver had a drape.
        metrics: by row.
    """

    case: str
    group: str
    groom: str
    clip: str
    shape: str
    frames: tuple[int, ...]
    reference: tuple[str, ...]
    metrics: dict[str, Metrics]
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
    """All metrics of a case's drapes, those against the reference where a solver has draped it.

    Each frame's body is posed once.
    """
    energy = HairEnergy(case.groom, material, terms_of_design(case.groom, body, material, case.loading))
    of_rows: dict[str, Metrics] = {name: {} for name in drapes}
    from_head: dict[str, list[Positions]] = {name: [] for name in drapes}
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
                of_rows[name].setdefault(key, []).append(value)
            if case.is_run and solvers:
                from_head[name].append(vertices_from_head(strands[name][None], scene.bodies))
    if case.is_run and solvers:
        _add_jitter(of_rows, from_head, solvers)
    _add_times(of_rows, drapes)
    return CaseResult(
        case=case.name,
        group=case.group,
        groom=case.groom.name,
        clip=case.motion.name,
        shape=case.shape,
        frames=case.frames,
        reference=tuple(reference),
        metrics=of_rows,
        machines=tuple(sorted({frame.machine for frames in drapes.values() for frame in frames if frame.machine})),
    )


def summarize(results: Sequence[CaseResult]) -> Summary:
    """Metrics over all cases, over free hair (`seen` and `unseen`), over each group and over each clip.

    The mean is that of the cases, each the mean of its frames, so that a run weighs no more than a frame; the worst is
    the worst frame. A row that misses a case of a group is left out there.
    """
    free = [result for result in results if result.group in ("seen", "unseen")]
    groups: dict[str, list[CaseResult]] = {"all": list(results)} | ({"free": free} if free else {})
    for result in results:
        groups.setdefault(result.group, []).append(result)
    for result in results:
        groups.setdefault(f"clip {result.clip}", []).append(result)
    return {group: _summarize_group(of_group) for group, of_group in groups.items()}


def _summarize_group(results: Sequence[CaseResult]) -> dict[str, dict[str, dict[str, float]]]:
    rows = [name for name in results[0].metrics if all(name in result.metrics for result in results)] if results else []
    summary: dict[str, dict[str, dict[str, float]]] = {}
    for row in rows:
        own = [result.metrics[row] for result in results]
        summary[row] = {}
        for key in dict.fromkeys(key for values in own for key in values):
            cases = [values[key] for values in own if key in values]
            every = [value for case in cases for value in case]
            middle = {"median": median(every)} if key == TIME else {"mean": mean(mean(case) for case in cases)}
            summary[row][key] = middle | {"worst": max(every)}
    return summary


def _add_jitter(of_rows: dict[str, Metrics], from_head: dict[str, list[Positions]], solvers: Sequence[str]) -> None:
    """Relative to the one solver that is lowest over the run: a reference that changes between frames would jitter."""
    jitter = {name: float(accelerations(torch.cat(frames)).mean()) for name, frames in from_head.items()}
    best = min(solvers, key=lambda name: mean(of_rows[name]["energy"]))
    if jitter[best] == 0:
        return  # nothing moves: no ratio
    for name, value in jitter.items():
        of_rows[name]["jitter"] = [value / jitter[best]]


def _add_times(of_rows: dict[str, Metrics], drapes: dict[str, list[TimedDrape]]) -> None:
    for name, frames in drapes.items():
        times = [frame.milliseconds for frame in frames if frame.milliseconds is not None]
        if times:
            of_rows[name][TIME] = times
