"""The picture of the inference benchmark. Needs matplotlib, which the extra `docs` brings."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from quaffure.benchmark.inference_benchmark import Floor, Timing
from quaffure.io.atomic import replacing


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
    with replacing(path) as beside:
        figure.savefig(beside, dpi=110, format="png")
