"""What the subcommands print."""

import json
import sys

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, TextColumn
from rich.table import Table

# Where the output is no terminal, rich would fold tables to 80 columns.
console = Console() if sys.stdout.isatty() else Console(width=140)


def progress_columns(time: ProgressColumn) -> tuple[ProgressColumn, ...]:
    """What is done, how many of how many, and how much time it took or will take."""
    return TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), time


def print_rows(rows: list[dict[str, object]], title: str) -> None:
    """A table whose columns are the keys of the first row."""
    table = Table(title=title, title_justify="left")
    for column in rows[0]:
        table.add_column(column, overflow="fold", no_wrap=column == next(iter(rows[0])))
    for row in rows:
        table.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row.values()))
    console.print(table)


def print_json(value: object) -> None:
    """Plain JSON, for other programs."""
    print(json.dumps(value, indent=1))
