"""`quaffure benchmark inference`: what a drape by the network costs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.progress import Progress, TimeElapsedColumn

from quaffure.apps.cli.benchmark_file import check_benchmark_out, write_benchmark
from quaffure.apps.cli.console import console, print_json, print_rows, progress_columns
from quaffure.benchmark.inference_benchmark import (
    COUNTS,
    QUICK_COUNTS,
    Floor,
    Timing,
    floor,
    inference_layout,
    model_dtype,
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
    """Drape ever more hairstyles by the network; print, write and plot time and memory, and what each part takes."""

    out: Path
    """The .json file to write; a plot goes beside it as .png."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled groom or a file; may be given several times, and they are taken in turn. Without it, long_straight."""
    weights: Path | None = None
    """A checkpoint; without it, the shipped one."""
    quick: bool = False
    """Only a few grooms: some seconds."""
    json: bool = False
    """Print the file's content instead of a table."""

    def run(self) -> None:
        check_benchmark_out(self.out)
        model = load_model(self.weights)
        if inference_layout(model) is None:
            raise InputError(self.weights or "weights", "a network that is compiled to drape", "another configuration")
        grooms = [load_groom(name, model.body) for name in self.groom or ("long_straight",)]
        counts = QUICK_COUNTS if self.quick else COUNTS
        with Progress(
            *progress_columns(TimeElapsedColumn()), console=console, transient=True, disable=self.json
        ) as progress:
            task = progress.add_task("preparing", total=len(counts))

            def on_count(count: int) -> None:
                progress.update(task, description=f"{count} grooms", completed=counts.index(count))

            timings = time_grooms(model, grooms, counts, on_count)
            strands = time_strands(model, grooms[0])
            parts = time_parts(model, grooms[0])
            fitting = time_fitting(model, grooms[0])
            least = floor(model, grooms[0])
        written = report(model, timings, strands, parts, fitting, least)
        drawn = write_benchmark(self.out, written, lambda picture: _plot(picture, timings, least))
        if self.json:
            print_json(written)
            return
        _print(model, timings + strands, parts, least)
        console.print(f"once for a new groom: {1000 * fitting:.0f} ms of processor time")
        console.print(drawn)


def _plot(picture: Path, timings: Sequence[Timing], least: Floor) -> None:
    from quaffure.benchmark.plots import plot_timings

    plot_timings(picture, timings, least)


def _print(model: Quaffure, timings: Sequence[Timing], parts: dict[str, float], least: Floor) -> None:
    print_rows([_row(timing) for timing in timings], f"drapes in {model_dtype(model)}")
    whole = sum(parts.values())
    rows: list[dict[str, object]] = [
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
    return {
        "grooms": timing.grooms,
        "strands": timing.strands,
        "wall s": timing.seconds,
        "CPU s": timing.cpu_seconds,
        "wall ms a groom": 1000 * timing.seconds / timing.grooms,
        "CPU ms a groom": 1000 * timing.cpu_seconds / timing.grooms,
        "peak MB": timing.peak_megabytes,
    }
