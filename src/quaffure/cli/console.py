"""What the subcommands print."""

import json

from rich.console import Console
from rich.table import Table

console = Console()


def print_rows(rows: list[dict[str, object]], title: str) -> None:
    """A table whose columns are the keys of the first row."""
    table = Table(title=title, title_justify="left")
    for column in rows[0]:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row.values()))
    console.print(table)


def print_json(value: object) -> None:
    """Plain JSON, for other programs."""
    print(json.dumps(value, indent=1))
