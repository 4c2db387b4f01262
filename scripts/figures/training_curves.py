"""Validation metrics against time: `python scripts/figures/training_curves.py RUN ... --out PICTURE`.

Each run is a folder of `quaffure train`, and named like it. Needs matplotlib, which the extra `docs` brings.
"""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import tyro
from matplotlib.figure import Figure
from tiles import run_figure

from quaffure.errors import InputError
from quaffure.io import replacing

LEAST_SHOWN = 1e-3  # of an energy; smaller differences come and go
COLUMNS = ("seconds", "energy", "body_intersection_percent")


class Curve(NamedTuple):
    """Validations of one training, the first one first.

    Attributes:
        seconds: of training until then.
        energy: sum of the terms, in the unit of the loss.
        inside: the body [%].
    """

    name: str
    seconds: list[float]
    energy: list[float]
    inside: list[float]


def main(runs: tyro.conf.Positional[tuple[Path, ...]], out: Path) -> list[Path]:
    curves = [read_curve(run.name.replace("_", " "), run) for run in runs]
    lowest = min(min(curve.energy) for curve in curves)
    plot_curves(out, curves, [lowest] * len(curves))
    return [out]


def read_curve(name: str, run: Path) -> Curve:
    """The validations of a training.

    Raises:
        InputError: it has none, or their table has other columns.
    """
    path = run / "validation.csv"
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        columns = [[float(row[column]) for row in rows] for column in COLUMNS]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(path, f"a table with the columns {', '.join(COLUMNS)}", str(error)) from error
    if not rows:
        raise InputError(path, "at least one validation", "none")
    return Curve(name, *columns)


def plot_curves(path: Path, curves: Sequence[Curve], zeros: Sequence[float], zero: str = "the lowest") -> None:
    """Energy above what each curve is measured from, `zero` in words, and hair inside the body; as a .png."""
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    above, inside = figure.subplots(1, 2)
    for curve, least in zip(curves, zeros):
        above.semilogy(curve.seconds, [max(energy - least, LEAST_SHOWN) for energy in curve.energy], label=curve.name)
        inside.semilogy(curve.seconds, curve.inside)
    above.set_ylabel(f"energy above {zero} [unit of the loss]")
    inside.set_ylabel("inside the body [%]")
    for axis in (above, inside):
        axis.set_xlabel("time of training [s]")
        axis.grid(alpha=0.3)
    above.legend(fontsize="small")
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")


if __name__ == "__main__":
    run_figure(main)
