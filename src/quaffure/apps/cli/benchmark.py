"""`quaffure benchmark`: solvers, energy against time on the same drapes; inference, see `benchmark_inference`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.progress import Progress, TimeElapsedColumn

from quaffure.apps.cli.benchmark_file import check_benchmark_out, write_benchmark
from quaffure.apps.cli.benchmark_inference import InferenceCommand
from quaffure.apps.cli.console import console, print_json, print_rows, progress_columns
from quaffure.apps.cli.inputs import motion_of
from quaffure.benchmark.solver_benchmark import Budget, Case, Run, budgets, report, run_benchmark
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.load_groom import load_groom
from quaffure.scene import BodyBatch, Scene

QUICK_STRANDS = 100
_NAMES = tuple(dict.fromkeys(budget.solver for budget in budgets()))


@dataclass(frozen=True)
class SolversCommand:
    """Drape the same frames by every solver with several budgets; print, write and plot energy against time.

    Energies are in m g L per vertex: what lifting it by its strand's length takes.
    """

    out: Path
    """The .json file to write; a plot goes beside it as .png."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled groom or a file; may be given several times. Without it, long_straight."""
    head: Path | None = None
    """The head mesh (.obj) that a groom file was made on; helps to register it."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled clip or a file; may be given several times. Without it, neck_turn, bow and shrug."""
    frames: str = ""
    """Frames A:B:STEP of every motion, each a case; without it, the middle one."""
    solver: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar=f"{{{','.join(_NAMES)}}}")] = ()
    """A solver to run, with all its budgets; may be given several times. Without it, all."""
    strands: int | None = None
    """Drape only so many strands of each groom, evenly chosen."""
    quick: bool = False
    """Small budgets on 100 strands, one case, without newton and xpbd_paper: some seconds."""
    json: bool = False
    """Print the file's content instead of a table."""

    def run(self) -> None:
        chosen = self._budgets()
        check_benchmark_out(self.out)
        if self.strands is not None and self.strands < 1:
            raise InputError("--strands", "1 or more", f"{self.strands}")
        body = load_body()
        cases = self._cases(body)
        with Progress(
            *progress_columns(TimeElapsedColumn()), console=console, transient=True, disable=self.json
        ) as progress:
            task = progress.add_task("compiling", total=len(cases) * len(chosen))
            begun: list[str] = []

            def on_run(label: str) -> None:
                progress.update(task, description=label, completed=len(begun))
                begun.append(label)

            runs = run_benchmark(cases, chosen, on_run=on_run)
        written = report(runs, chosen)
        drawn = write_benchmark(self.out, written, lambda picture: _plot(picture, runs))
        if self.json:
            print_json(written)
            return
        for case in cases:
            rows = [_row(run) for run in runs if run.case == case.name]
            print_rows(rows, f"{case.name}; energies in m g L per vertex")
        if any(run.share < 1 for run in runs):
            console.print("~ extrapolated from a part of the run")
        console.print(drawn)

    def _budgets(self) -> list[Budget]:
        every = budgets(self.quick)
        known = list(dict.fromkeys(budget.solver for budget in every))
        for name in self.solver:
            if name not in known:
                source = "--solver with --quick" if self.quick and name in _NAMES else "--solver"
                raise InputError(source, f"one of {', '.join(known)}", f"'{name}'")
        return [budget for budget in every if not self.solver or budget.solver in self.solver]

    def _cases(self, body: BodyModel) -> list[Case]:
        motions = [motion_of(name, body) for name in self.motion or (("neck_turn",) if self.quick else _CLIPS)]
        strands = self.strands if self.strands is not None else (QUICK_STRANDS if self.quick else None)
        grooms = [_thinned(load_groom(name, body, self.head), strands) for name in self.groom or ("long_straight",)]
        cases = []
        for motion in motions:
            for pose, name in _poses(motion, self.frames):
                bodies = BodyBatch(body, pose, torch.zeros(1, 10))
                cases += [Case(f"{groom.name}, {name}", Scene(groom, bodies)) for groom in grooms]
        return cases


@dataclass(frozen=True)
class BenchmarkCommand:
    """Measure solvers against each other, or what a drape by the network costs."""

    what: (
        Annotated[SolversCommand, tyro.conf.subcommand("solvers")]
        | Annotated[InferenceCommand, tyro.conf.subcommand("inference")]
    )

    def run(self) -> None:
        self.what.run()


_CLIPS = ("neck_turn", "bow", "shrug")


def _poses(motion: Motion, frames: str) -> list[tuple[torch.Tensor, str]]:
    """Poses [1, 81] and what to call them."""
    if not frames:
        middle = len(motion) // 2
        return [(motion.body_pose[middle : middle + 1], f"{motion.name} {middle}")]
    chosen = motion.frames(frames).body_pose
    return [(pose[None], f"{motion.name} {frames} #{index}") for index, pose in enumerate(chosen)]


def _thinned(groom: Groom, strands: int | None) -> Groom:
    if strands is None or strands >= len(groom):
        return groom
    return groom.select(torch.linspace(0, len(groom) - 1, strands).long())


def _plot(picture: Path, runs: Sequence[Run]) -> None:
    from quaffure.benchmark.plots import plot_runs

    plot_runs(picture, runs)


def _row(run: Run) -> dict[str, object]:
    mark = "" if run.share == 1 else "~"
    return {
        "solver": run.solver,
        "budget": run.effort or "",
        "iterations": "" if run.iterations is None else run.iterations,
        "energy": run.energy,
        "above the best": run.excess_energy,
        "relative gradient": run.relative_gradient,
        "own gradient": "" if run.reported_gradient is None else run.reported_gradient,
        "body intersection %": run.body_intersection_percent,
        "length error %": run.length_error_percent,
        "density excess %": run.density_excess_percent,
        "wall s": f"{mark}{run.seconds:.3g}",
        "CPU s": f"{mark}{run.cpu_seconds:.3g}",
    }
