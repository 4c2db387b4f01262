"""The picture of the solver benchmark. Needs matplotlib, which the extra `docs` brings."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from quaffure.benchmark.solver_benchmark import Run
from quaffure.io.atomic import replacing

LEAST_EXCESS = 1e-5
"""Where the best run is drawn, which has no excess and so no place on a logarithmic axis."""


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
    with replacing(path) as beside:
        figure.savefig(beside, dpi=110, format="png")
