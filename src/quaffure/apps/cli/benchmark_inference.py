"""`quaffure benchmark inference`: time and memory of a drape by the network."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from quaffure.apps.cli.benchmark_file import check_benchmark_output, write_benchmark
from quaffure.apps.cli.console import console, print_json, print_rows, progress_bar
from quaffure.benchmark.inference_benchmark import (
    COUNTS,
    QUICK_COUNTS,
    Floor,
    Timing,
    floor,
    report,
    time_fitting,
    time_grooms,
    time_parts,
    time_strands,
)
from quaffure.errors import InputError
from quaffure.io.load_groom import load_groom
from quaffure.model.quaffure_model import Quaffure, load_model


@dataclass(frozen=True)
class InferenceCommand:
    """Drape more and more grooms by the network; print, write and plot time and memory, and the time of each part."""

    out: Path
    """The .json file to write; a plot is written next to it as .png."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled groom or a file; may be given several times, to be used in turn. Without it, long_straight."""
    weights: Path | None = None
    """A checkpoint; without it, the shipped one."""
    quick: bool = False
    """Only a few grooms: takes some seconds."""
    json: bool = False
    """Print the content of the file instead of a table."""

    def run(self) -> None:
        check_benchmark_output(self.out)
        model = load_model(self.weights)
        if not model.draper.is_compiled(model.body):
            raise InputError(self.weights or "weights", "a network that is compiled to drape", "another configuration")
        grooms = [load_groom(name, model.body) for name in self.groom or ("long_straight",)]
        counts = QUICK_COUNTS if self.quick else COUNTS
        with progress_bar("preparing", len(counts), transient=True, disable=self.json) as update:

            def on_count(count: int) -> None:
                update(description=f"{count} grooms", completed=counts.index(count))

            timings = time_grooms(model, grooms, counts, on_count)
            strands = time_strands(model, grooms[0])
            parts = time_parts(model, grooms[0])
            fitting = time_fitting(model, grooms[0])
            least = floor(model.draper.compiled(), model.draper.packed(grooms[0], model.body))
        content = report(model, timings, strands, parts, fitting, least)
        message = write_benchmark(self.out, content, lambda picture: _plot(picture, timings, least))
        if self.json:
            print_json(content)
            return
        _print(model, timings + strands, parts, least)
        console.print(f"once for a new groom: {1000 * fitting:.0f} ms of processor time")
        console.print(message)


def _plot(picture: Path, timings: Sequence[Timing], least: Floor) -> None:
    from quaffure.benchmark.inference_plot import plot_timings

    plot_timings(picture, timings, least)


def _print(model: Quaffure, timings: Sequence[Timing], parts: dict[str, float], least: Floor) -> None:
    print_rows([_row(timing) for timing in timings], f"drapes in {model.draper.compiled().network.dtype}")
    whole = sum(parts.values())
    rows = [
        {"part of a drape": name.replace("_", " "), "CPU ms": 1000 * seconds, "share %": 100 * seconds / whole}
        for name, seconds in parts.items()
    ]
    print_rows(rows, "in a full batch")
    console.print(
        f"floor of the network's arithmetic: {1000 * least.seconds:.2f} ms a groom "
        f"({least.operations / 1e9:.2f} G operations at {least.operations_per_second / 1e9:.0f} G/s, "
        f"{least.bytes_moved / 1e6:.1f} MB at {least.bytes_per_second / 1e9:.1f} GB/s)"
    )


def _row(timing: Timing) -> dict[str, object]:
    """The measured values by column, and the times of one groom."""
    values = {name.replace("_", " "): value for name, value in asdict(timing).items()}
    seconds = {"ms a groom": timing.seconds, "CPU ms a groom": timing.cpu_seconds}
    return values | {column: 1000 * value / timing.grooms for column, value in seconds.items()}
