"""`quaffure crowd`: drape a table of characters on all processors."""

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.character_table import DRAPERS, NEURAL, drape_rows, read_table
from quaffure.apps.cli.console import console, print_json, progress_bar
from quaffure.apps.cli.outputs import check_outputs
from quaffure.errors import InputError

ROWS_FAILED = 4
"""Exit code where rows have failed; all others are written."""


@dataclass(frozen=True)
class CharactersCommand:
    """Drape a table of characters, one row after another in as many processes as there are processors.

    Rows whose output is there are not done again, so the same command continues what was interrupted. A row that fails
    is named, and the others go on.
    """

    table: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TABLE")]
    """A .csv with the columns groom, motion and out, and if wanted frames, shape (ten numbers separated by spaces),
    stiffness, seed (of a bundled style) and body (a file of `quaffure body import`)."""
    draper: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(DRAPERS)}}}")] = NEURAL
    """The network, or the solver, whose clips do not jump."""
    workers: int = 0
    """Processes; 0 is one for each processor. Each takes up to 2 GB."""
    retries: int = 1
    """How often a row is tried again that failed for another reason than its input."""
    json: bool = False
    """Print as JSON what was done."""

    def run(self) -> None:
        console.quiet = self.json
        if self.draper not in DRAPERS:
            raise InputError("--draper", f"one of {', '.join(DRAPERS)}", f"'{self.draper}'")
        for option, value in (("--workers", self.workers), ("--retries", self.retries)):
            if value < 0:
                raise InputError(option, "0 or more", f"{value}")
        rows = read_table(self.table)
        check_outputs([Path(row.out) for row in rows], (self.table,))
        left = [row for row in rows if not Path(row.out).exists()]
        workers = min(self.workers or os.cpu_count() or 1, max(len(left), 1))
        console.print(f"{len(rows)} rows, {len(rows) - len(left)} of them finished before; {workers} processes")
        begin, failed = time.perf_counter(), {}
        with progress_bar("draping", len(left), transient=True) as update:
            for finished in drape_rows(left, self.draper, workers, self.retries):
                update(advance=1)
                if finished.error:
                    failed[finished.row.out] = finished.error
                    console.print(f"{finished.row.out}: {finished.error}", markup=False, highlight=False)
        seconds = time.perf_counter() - begin
        done = len(left) - len(failed)
        if self.json:
            print_json({"rows": len(rows), "written": done, "failed": failed, "seconds": seconds})
        console.print(f"written: {done} in {seconds:.1f} s; failed: {len(failed)}")
        if failed:
            sys.exit(ROWS_FAILED)
