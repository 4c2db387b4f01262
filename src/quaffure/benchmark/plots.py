"""Plots of evaluations and benchmarks, as .png files. Needs matplotlib, which the extra `docs` brings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quaffure.benchmark.inference_benchmark import Floor, Timing
from quaffure.benchmark.solver_benchmark import Run
from quaffure.io.atomic import replacing

PANELS = {
    "excess_energy": "energy above the best solver's [m g L per vertex]",
    "body_intersection_percent": "vertices inside the body [%]",
}
LEAST = 1e-4
"""Where zero is drawn on a logarithmic axis."""
LEAST_EXCESS = 1e-5
"""The same for the best run of a solver, which has no excess."""


def plot_results(path: Path, results: dict[str, Any]) -> None:
    """Quality against time, one mark a draper, means over all cases, as a .png.

    Raises:
        InputError: the folder of `path` does not exist or is not writable.
    """
    rows = results["summary"]["all"]
    timed = {name: row for name, row in rows.items() if "milliseconds" in row}
    panels = [key for key in PANELS if any(key in row for row in timed.values())]
    figure = Figure(figsize=(1.0 + 4.8 * len(panels), 4.4), layout="constrained")
    for index, key in enumerate(panels):
        axis = figure.add_subplot(1, len(panels), index + 1)
        _panel(axis, {name: row for name, row in timed.items() if key in row}, key)
        axis.set_xlabel("median time of a drape [ms]")
        axis.set_ylabel(PANELS[key])
    _save(path, figure)


def _panel(axis: Axes, rows: dict[str, Any], key: str) -> None:
    for name, row in rows.items():
        position = max(row["milliseconds"]["median"], 1e-3), max(row[key]["mean"], LEAST)
        axis.plot(*position, marker="o", linestyle="none")
        axis.annotate(name, position, xytext=(0, 7), textcoords="offset points", fontsize="small", ha="center")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.margins(0.25)
    axis.grid(alpha=0.3)


def plot_timings(path: Path, timings: Sequence[Timing], least: Floor) -> None:
    """Wall time against the number of grooms, with the floor of the network's arithmetic, as a .png.

    Raises:
        InputError: the folder of `path` does not exist or is not writable.
    """
    figure = Figure(figsize=(5.6, 4.2), layout="constrained")
    axis = figure.subplots()
    grooms = [timing.grooms for timing in timings]
    axis.loglog(grooms, [timing.seconds for timing in timings], marker="o", label="wall time")
    axis.loglog(grooms, [count * least.seconds for count in grooms], "--", label="floor of the network's arithmetic")
    axis.set_xlabel("grooms")
    axis.set_ylabel("time [s]")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    _save(path, figure)


def plot_runs(path: Path, runs: Sequence[Run]) -> None:
    """Excess energy against wall time, one panel a case, as a .png.

    Raises:
        InputError: the folder of `path` does not exist or is not writable.
    """
    cases = list(dict.fromkeys(run.case for run in runs))
    figure = Figure(figsize=(3.0 + 4.6 * len(cases), 4.2), layout="constrained")
    axes = figure.subplots(1, len(cases), squeeze=False, sharey=True)[0]
    for axis, case in zip(axes, cases):
        of_case = [run for run in runs if run.case == case and run.seconds > 0 and run.solver != "posed"]
        for name in dict.fromkeys(run.solver for run in of_case):
            line = sorted((run for run in of_case if run.solver == name), key=lambda run: run.seconds)
            label = name if line[0].share == 1 else f"{name} ({line[0].share:.0%} run, time extrapolated)"
            axis.loglog(
                [run.seconds for run in line],
                [max(run.excess_energy, LEAST_EXCESS) for run in line],
                marker="o" if line[0].share == 1 else "x",
                label=label,
            )
        axis.set_title(case, fontsize="medium")
        axis.set_xlabel("wall time [s]")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("energy above the best [m g L per vertex]")
    lines, names = axes[-1].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside right upper", fontsize="small")
    _save(path, figure)


def _save(path: Path, figure: Figure) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
