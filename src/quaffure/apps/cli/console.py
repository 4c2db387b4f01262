"""Terminal output of the subcommands: tables, JSON, progress bars."""

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from datetime import timedelta
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from torch import nn

from quaffure.benchmark.report import cell_text
from quaffure.errors import refused
from quaffure.model.inference_network import lacks_bfloat16
from quaffure.training.loop import LAST, Training, train


class PlainConsole(Console):
    """Prints texts as they are: names and texts of files may look like markup, and lines are as long as they are.

    Where nothing takes the output any more (a closed pipe, a full disk, a terminal that is gone), the work goes on
    without it.

    Args:
        stderr: print on the error stream.

    Attributes:
        lost: why lines were not printed; empty where they were, or where a reader has closed its pipe.
    """

    lost = ""

    def __init__(self, stderr: bool = False) -> None:
        stream = sys.stderr if stderr else sys.stdout
        # If the output is not a terminal, rich would wrap tables at 80 columns.
        width = None if stream is not None and stream.isatty() else 140
        super().__init__(stderr=stderr, width=width, markup=False, highlight=False, emoji=False, soft_wrap=True)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print what `rich.console.Console.print` takes."""
        try:
            super().print(*objects, **options)
        except OSError as error:
            self.lost = str(error.strerror)
            self.on_broken_pipe()

    def on_broken_pipe(self) -> None:
        """Print nothing from now on; rich would end the process."""
        self.quiet = True
        # Python flushes the stream when it ends, and would fail again.
        if (stream := sys.stderr if self.stderr else sys.stdout) is not None:
            with open(os.devnull, "wb") as nowhere, suppress(OSError, ValueError):
                os.dup2(nowhere.fileno(), stream.fileno())


# Commands with --json set `quiet`: then only `print_json` writes to the output.
console = PlainConsole()
Update = Callable[..., None]
Text = Callable[[dict[str, float]], str]
LEAST_SECONDS, MOST_SECONDS = 1.0, 20.0
"""Bounds of the time between two lines of progress [s]."""
SHARE_PER_LINE = 0.1
"""That time as a share of what the work has taken, within the bounds."""


def counted(count: int, noun: str, ending: str = "s") -> str:
    """A number of things in words: `1 row`, `2 rows`.

    Args:
        ending: of the plural.
    """
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{ending}"


@contextmanager
def progress_bar(
    description: str, total: int | None, done: int = 0, to: Console = console, **options: bool
) -> Iterator[Update]:
    """Show a bar with the number of finished parts and the time left, or taken once it is full. Where the output is no
    terminal, print a line now and then instead.

    Args:
        options: of `rich.progress.Progress`: `transient` bars disappear when they end, `disable` shows none.

    Yields:
        A function that takes what `rich.progress.Progress.update` does: `completed`, `advance`, `description`, `total`.
    """
    if not to.is_terminal:
        lines = ProgressLines(description, total, done, to)
        yield (lambda **changes: None) if options.get("disable") else lines.update
        return
    time_column = TimeRemainingColumn(elapsed_when_finished=True)
    columns = TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), time_column
    with Progress(*columns, console=to, **options) as progress:  # type: ignore[arg-type]
        yield partial(progress.update, progress.add_task(description, total=total, completed=done))


class ProgressLines:
    """Plain lines about a work in parts, for files, pipes and the Blender add-on: after its first part, then the rarer
    the longer it takes.

    Args:
        description: the end of every line.
        total: number of parts, where it is known.
        done: parts that are finished already.
    """

    def __init__(self, description: str, total: int | None, done: int, to: Console) -> None:
        self._description, self._total, self._done, self._to = description, total, done, to
        self._printed, self._clock = -math.inf, (time.monotonic(), done)

    def update(
        self,
        *,
        completed: int | None = None,
        advance: int = 0,
        description: str | None = None,
        total: int | None = None,
    ) -> None:
        """Take what a bar takes."""
        before = self._done
        self._done = advance + (self._done if completed is None else completed)
        self._description, self._total = description or self._description, total or self._total
        now = time.monotonic()
        interval = min(max(SHARE_PER_LINE * (now - self._clock[0]), LEAST_SECONDS), MOST_SECONDS)
        if self._done > before and self._done != self._total and now - self._printed >= interval:
            self._printed = now
            line = f"{self._done}{self._rest(now)}: {self._description}"
            self._to.print(line)

    def _rest(self, now: float) -> str:
        if self._total is None:
            return ""
        start, before = self._clock
        left = (now - start) / (self._done - before) * (self._total - self._done)
        return f" of {self._total}, {timedelta(seconds=round(left))} left"


class TimeLeft:
    """Estimates how long the rest of a run takes, from its mean speed so far.

    Args:
        total: steps of the run.
        done: steps of it that were made before now.
    """

    def __init__(self, total: int, done: int = 0) -> None:
        self._total, self._before, self._start = total, done, time.monotonic()

    def at(self, done: int) -> timedelta:
        """Time left when `done` steps of the run are made, whole seconds."""
        seconds_per_step = (time.monotonic() - self._start) / (done - self._before)
        return timedelta(seconds=round(seconds_per_step * (self._total - done)))


def run_training(
    training: Training[Any],
    bar_text: Text,
    validation_text: Text = lambda values: "",
    to: Console = console,
    start: nn.Module | None = None,
) -> None:
    """Continue a training to its end, with a bar, and a line for every validation, for logs without a terminal.

    Args:
        bar_text, validation_text: the text of the bar and of the line from the values of a step; empty for no line.
        start: the network whose weights a new run starts from.

    Raises:
        InputError: another process trains in the same folder.
    """
    # Of the processes that share a run, the first one writes.
    with training.folder.locked() if training.recipe.worker.is_first else nullcontext():
        _run_training(training, bar_text, validation_text, to, start)


def _run_training(
    training: Training[Any], bar_text: Text, validation_text: Text, to: Console, start: nn.Module | None
) -> None:
    is_first, total = training.recipe.worker.is_first, training.recipe.config.steps
    on_cpu = training.recipe.worker.device.type == "cpu"
    if is_first and on_cpu and training.recipe.config.bf16 and lacks_bfloat16():
        to.print("this processor has no instructions for bfloat16: steps are faster without --bf16")
    if training.resume():
        if is_first:
            to.print(f"resuming from step {training.step} of {total}")
    elif start is not None:
        training.start_from(start)
        if is_first and training.recipe.validate_every is not None:
            to.print("measuring the weights to start from")
            text = validation_text(training.validate())
            to.print(f"before training: {text}")
    left = TimeLeft(total, training.step)
    with progress_bar("training", total, training.step, to, disable=not is_first) as update:

        def report(step: int, values: dict[str, float]) -> None:
            update(completed=step, description=bar_text(values))
            if text := validation_text(values):
                to.print(f"step {step} of {total}: {text}; {left.at(step)} left")

        try:
            train(training, report)
        except (KeyboardInterrupt, SystemExit):
            if is_first:
                to.print(f"stopped at step {training.step} of {total}; the same command continues")
                if training.recipe.validate_every is not None:
                    to.print(f"weights: {training.folder.path / LAST}")
            raise
    if training.optimizer.skipped and is_first:
        to.print(f"{training.optimizer.skipped} updates skipped: gradients that were not finite")


def print_rows(rows: Sequence[Mapping[str, object]], title: str) -> None:
    """Print a table whose columns are the keys of the first row."""
    table = Table(title=title, title_justify="left")
    for column in rows[0]:
        table.add_column(column, overflow="fold", no_wrap=column == next(iter(rows[0])))
    for row in rows:
        table.add_row(*(cell_text(value) for value in row.values()))
    console.print(table, soft_wrap=False)


def print_json(value: object) -> None:
    """Print plain JSON, for other programs.

    Raises:
        InputError: nothing takes it.
    """
    with refused("standard output", "a place that takes the JSON", OSError):
        print(json.dumps(value, indent=1), flush=True)
