"""`quaffure benchmark solvers`: energy against time on the same drapes; and the command around both benchmarks."""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro

from quaffure.apps.cli.benchmark_file import check_benchmark_output, write_benchmark
from quaffure.apps.cli.benchmark_inference import InferenceCommand
from quaffure.apps.cli.console import console, print_json, print_rows, progress_bar
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

    Energies are in m g L per vertex: the energy to lift it by the length of its strand.
    """

    out: Path
    """The .json file to write; a plot is written next to it as .png."""
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
    """Drape only this many strands of each groom, evenly spaced."""
    quick: bool = False
    """Small budgets on 100 strands, one case, without newton and xpbd_paper: takes some seconds."""
    json: bool = False
    """Print the content of the file instead of a table."""

    def run(self) -> None:
        chosen = self._budgets()
        check_benchmark_output(self.out)
        if self.strands is not None and self.strands < 1:
            raise InputError("--strands", "1 or more", f"{self.strands}")
        body = load_body()
        cases = self._cases(body)
        finished = itertools.count()
        with progress_bar("compiling", len(cases) * len(chosen), transient=True, disable=self.json) as update:
            runs = run_benchmark(
                cases, chosen, on_run=lambda label: update(description=label, completed=next(finished))
            )
        content = report(runs, chosen)
        message = write_benchmark(self.out, content, lambda picture: _plot(picture, runs))
        if self.json:
            print_json(content)
            return
        for case in cases:
            rows = [_row(run) for run in runs if run.case == case.name]
            print_rows(rows, f"{case.name}; energies in m g L per vertex")
        if any(run.share < 1 for run in runs):
            console.print("share below 1: times are extrapolated from that part of the run")
        console.print(message)

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
        grooms = [_subset(load_groom(name, body, self.head), strands) for name in self.groom or ("long_straight",)]
        cases = []
        for motion in motions:
            for pose, name in _poses(motion, self.frames):
                bodies = BodyBatch(body, pose, torch.zeros(1, 10))
                cases += [Case(f"{groom.name}, {name}", Scene(groom, bodies)) for groom in grooms]
        return cases


@dataclass(frozen=True)
class BenchmarkCommand:
    """Compare solvers, or measure time and memory of a drape by the network."""

    what: (
        Annotated[SolversCommand, tyro.conf.subcommand("solvers")]
        | Annotated[InferenceCommand, tyro.conf.subcommand("inference")]
    )

    def run(self) -> None:
        self.what.run()


_CLIPS = ("neck_turn", "bow", "shrug")


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


def _plot(picture: Path, runs: Sequence[Run]) -> None:
    from quaffure.benchmark.solver_plot import plot_runs

    plot_runs(picture, runs)


def _row(run: Run) -> dict[str, object]:
    """The values of the run by column, without its case."""
    values = asdict(run)
    del values["case"]
    return {name.replace("_", " "): "" if value is None else value for name, value in values.items()}
