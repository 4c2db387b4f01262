"""The picture of an evaluation. Needs matplotlib, which the extra `docs` brings."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quaffure.io.atomic import replacing

PANELS = {
    "excess_energy": "energy above the best solver's [m g L per vertex]",
    "body_intersection_percent": "vertices inside the body [%]",
}
LEAST = 1e-4
"""Where nothing is drawn, which has no place on a logarithmic axis."""


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
    with replacing(path) as beside:
        figure.savefig(beside, dpi=110, format="png")


def _panel(axis: Axes, rows: dict[str, Any], key: str) -> None:
    for name, row in rows.items():
        place = max(row["milliseconds"]["median"], 1e-3), max(row[key]["mean"], LEAST)
        axis.plot(*place, marker="o", linestyle="none")
        axis.annotate(name, place, xytext=(0, 7), textcoords="offset points", fontsize="small", ha="center")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.margins(0.25)
    axis.grid(alpha=0.3)
