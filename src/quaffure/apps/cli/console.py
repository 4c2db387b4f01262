"""Terminal output of the subcommands: tables, JSON, progress bars."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from quaffure.io.atomic import replacing

# If the output is not a terminal, rich would wrap tables at 80 columns. Commands with --json set `quiet`: then only
# `print_json` writes to the output.
console = Console() if sys.stdout.isatty() else Console(width=140)
Update = Callable[..., None]
Text = Callable[[dict[str, float]], str]


@contextmanager
def progress_bar(
    description: str, total: int | None, done: int = 0, to: Console = console, **options: bool
) -> Iterator[Update]:
    """Show a bar with the number of finished parts and the time left, or taken once it is full.

    Args:
        options: of `rich.progress.Progress`: `transient` bars disappear when they end, `disable` shows none.

    Yields:
        A function that takes what `rich.progress.Progress.update` does: `completed`, `advance`, `description`, `total`.
    """
    time_column = TimeRemainingColumn(elapsed_when_finished=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), time_column
    with Progress(*columns, console=to, **options) as progress:  # type: ignore[arg-type]
        yield partial(progress.update, progress.add_task(description, total=total, completed=done))


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


@contextmanager
def training_bar(
    total: int, done: int, bar_text: Text, validation_text: Text, shown: bool = True
) -> Iterator[Callable[[int, dict[str, float]], None]]:
    """Show the progress of a training: a bar, and a line for every validation, for logs without a terminal.

    Args:
        total: steps of the run.
        done: steps of it that were made before now.
        bar_text, validation_text: the text of the bar and of the line from the values of a step; empty for no line.

    Yields:
        A function to call with the number of the step and its values.
    """
    left = TimeLeft(total, done)
    with progress_bar("training", total, done, disable=not shown) as update:

        def report(step: int, values: dict[str, float]) -> None:
            update(completed=step, description=bar_text(values))
            if text := validation_text(values):
                console.print(f"step {step} of {total}: {text}; {left.at(step)} left")

        yield report


def print_rows(rows: Sequence[Mapping[str, object]], title: str) -> None:
    """Print a table whose columns are the keys of the first row."""
    table = Table(title=title, title_justify="left")
    for column in rows[0]:
        table.add_column(column, overflow="fold", no_wrap=column == next(iter(rows[0])))
    for row in rows:
        table.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row.values()))
    console.print(table)


def print_json(value: object) -> None:
    """Print plain JSON, for other programs."""
    print(json.dumps(value, indent=1))


def write_json(path: Path, value: object) -> None:
    """Write plain JSON.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
