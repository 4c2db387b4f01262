"""`quaffure benchmark`: solvers, energy against time on the same drapes; inference, time and memory of the network."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro

from quaffure.apps.cli.console import console, print_json, print_rows, progress_bar
from quaffure.apps.cli.inputs import motion_of
from quaffure.benchmark import inference_benchmark as inference
from quaffure.benchmark.solver_benchmark import Budget, Case, Run, budgets, report, run_benchmark
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.energies.by_name import MODIFIED_COSSERAT, ROD
from quaffure.errors import InputError
from quaffure.extras import is_installed
from quaffure.hair.groom import Groom
from quaffure.io.atomic import write_json
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output
from quaffure.model.quaffure_model import Quaffure, load_model
from quaffure.scene import BodyBatch, Scene

QUICK_STRANDS = 100
_NAMES = tuple(dict.fromkeys(budget.solver for kind in (ROD, MODIFIED_COSSERAT) for budget in budgets(kind)))
_CLIPS = ("neck_turn", "bow", "shrug")


@dataclass(frozen=True)
class SolversCommand:
    """Drape the same frames by every solver with several budgets; print, write and plot energy against time.

    Energies are in m g L per vertex: the energy to lift it by the length of its strand.
    """

    out: Path
    """The .json file to write; a plot is written next to it as .png."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled groom or a file; may be given several times. Without it, long_straight."""
    head: Path | None = None
    """The head mesh (.obj, .ply) that a groom file was made on; helps to register it."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled clip or a file; may be given several times. Without it, neck_turn, bow and shrug."""
    frames: str = ""
    """Frames A:B:STEP of every motion, each a case; without it, the middle one."""
    solver: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar=f"{{{','.join(_NAMES)}}}")] = ()
    """A solver to run, with all its budgets; may be given several times. Without it, all."""
    elastic: Annotated[str, tyro.conf.arg(metavar=f"{{{ROD},{MODIFIED_COSSERAT}}}")] = ROD
    """The elastic model: the rod, at rest in the design, or the paper's, which strand_newton does not minimize."""
    strands: int | None = None
    """Drape only this many strands of each groom, evenly spaced."""
    quick: bool = False
    """Small budgets on 100 strands, one case, without xpbd_paper: takes some seconds."""
    json: bool = False
    """Print the content of the file instead of a table."""

    def run(self) -> None:
        console.quiet = self.json
        chosen = self._budgets()
        _check_files(self.out, (*self.groom, *self.motion, self.head))
        if self.strands is not None and self.strands < 1:
            raise InputError("--strands", "1 or more", f"{self.strands}")
        body = load_body()
        cases = self._cases(body)
        finished = itertools.count()
        with progress_bar("compiling", len(cases) * len(chosen), transient=True) as update:
            runs = run_benchmark(
                cases, chosen, self.elastic, on_run=lambda label: update(description=label, completed=next(finished))
            )
        content = report(runs, chosen)
        message = _write_files(self.out, content, lambda plots, picture: plots.plot_runs(picture, runs))
        if self.json:
            print_json(content)
        for case in cases:
            rows = [_run_row(run) for run in runs if run.case == case.name]
            print_rows(rows, f"{case.name}; energies in m g L per vertex")
        if any(run.share < 1 for run in runs):
            console.print("share below 1: times are extrapolated from that part of the run")
        console.print(message)

    def _budgets(self) -> list[Budget]:
        if self.elastic not in (ROD, MODIFIED_COSSERAT):
            raise InputError("--elastic", f"{ROD} or {MODIFIED_COSSERAT}", f"'{self.elastic}'")
        every = budgets(self.elastic, self.quick)
        known = list(dict.fromkeys(budget.solver for budget in every))
        for name in self.solver:
            if name not in known:
                source = "--solver with these options" if name in _NAMES else "--solver"
                raise InputError(source, f"one of {', '.join(known)}", f"'{name}'")
        return [budget for budget in every if not self.solver or budget.solver in self.solver]

    def _cases(self, body: BodyModel) -> list[Case]:
        names = self.motion or (("neck_turn",) if self.quick else _CLIPS)
        motions = [motion_of(name, body, in_place=True) for name in names]
        strands = self.strands if self.strands is not None else (QUICK_STRANDS if self.quick else None)
        grooms = [_subset(load_groom(name, body, self.head), strands) for name in self.groom or ("long_straight",)]
        cases = []
        for motion in motions:
            for pose, name in _poses(motion, self.frames):
                bodies = BodyBatch(body, pose, torch.zeros(1, 10))
                cases += [Case(f"{groom.name}, {name}", Scene(groom, bodies)) for groom in grooms]
        return cases


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
        console.quiet = self.json
        _check_files(self.out, (*self.groom, self.weights))
        model = load_model(self.weights)
        inference.inference_layout(model)  # refused before the work
        grooms = [load_groom(name, model.body) for name in self.groom or ("long_straight",)]
        counts = inference.QUICK_COUNTS if self.quick else inference.COUNTS
        with progress_bar("preparing", len(counts), transient=True) as update:

            def on_count(count: int) -> None:
                update(description=f"{count} grooms", completed=counts.index(count))

            timings = inference.time_grooms(model, grooms, counts, on_count)
            strands = inference.time_strands(model, grooms[0])
            parts = inference.time_parts(model, grooms[0])
            fitting = inference.time_fitting(model, grooms[0])
            least = inference.floor(model, grooms[0])
        content = inference.report(model, timings, strands, parts, fitting, least)
        message = _write_files(self.out, content, lambda plots, picture: plots.plot_timings(picture, timings, least))
        if self.json:
            print_json(content)
        _print_timings(model, timings + strands, parts, least)
        console.print(f"once for a new groom: {1000 * fitting:.0f} ms of processor time")
        console.print(message)


@dataclass(frozen=True)
class BenchmarkCommand:
    """Compare solvers, or measure time and memory of a drape by the network."""

    what: (
        Annotated[SolversCommand, tyro.conf.subcommand("solvers")]
        | Annotated[InferenceCommand, tyro.conf.subcommand("inference")]
    )

    def run(self) -> None:
        self.what.run()


def _check_files(out: Path, inputs: Sequence[str | Path | None]) -> None:
    """Refuse the .json file or the plot next to it, before the work.

    Raises:
        InputError: another suffix, no folder to write into, a folder of one of these names, or an input.
    """
    check_output(out, ".json", inputs=inputs)
    check_output(out.with_suffix(".png"), ".png", inputs=inputs)


def _write_files(out: Path, content: dict[str, object], plot: Callable[[Any, Path], None]) -> str:
    """Write the file and the plot.

    Args:
        plot: writes the picture with the module `quaffure.benchmark.plots`, which needs matplotlib.

    Returns:
        A message that names the written files.
    """
    write_json(out, content)
    if not is_installed("matplotlib"):
        return f"written: {out}; no plot without matplotlib: pip install 'quaffure[docs]'"
    from quaffure.benchmark import plots

    plot(plots, out.with_suffix(".png"))
    return f"written: {out}, {out.with_suffix('.png')}"


def _poses(motion: Motion, frames: str) -> list[tuple[torch.Tensor, str]]:
    """Poses [1, 81] and their names."""
    if not frames:
        middle = len(motion) // 2
        return [(motion.body_pose[middle : middle + 1], f"{motion.name} {middle}")]
    chosen = motion.frames(frames).body_pose
    return [(pose[None], f"{motion.name} {frames} #{index}") for index, pose in enumerate(chosen)]


def _subset(groom: Groom, strands: int | None) -> Groom:
    if strands is None or strands >= len(groom):
        return groom
    return groom.select(torch.linspace(0, len(groom) - 1, strands).long())


def _run_row(run: Run) -> dict[str, object]:
    """The values of the run by column, without its case."""
    values = {name: value for name, value in asdict(run).items() if name != "case"}
    return {name.replace("_", " "): "" if value is None else value for name, value in values.items()}


def _print_timings(
    model: Quaffure, timings: Sequence[inference.Timing], parts: dict[str, float], least: inference.Floor
) -> None:
    print_rows([_timing_row(timing) for timing in timings], f"drapes in {inference.inference_layout(model).dtype}")
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


def _timing_row(timing: inference.Timing) -> dict[str, object]:
    """The measured values by column, and the times of one groom."""
    values = {name.replace("_", " "): value for name, value in asdict(timing).items()}
    seconds = {"ms a groom": timing.seconds, "CPU ms a groom": timing.cpu_seconds}
    return values | {column: 1000 * value / timing.grooms for column, value in seconds.items()}
