"""`quaffure crowd`: drape a table of characters on all processors, or on a Ray cluster."""

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.character_table import CLIP_DRAPERS, read_table
from quaffure.apps.cli.console import console, counted, print_json, progress_bar
from quaffure.apps.cli.outputs import check_outputs, files_of
from quaffure.apps.row_workers import LocalProcesses, RayCluster, RowWorkers, drape_rows
from quaffure.drapers import NEURAL
from quaffure.errors import InputError
from quaffure.io.output_path import check_no_inputs, made_folder

ROWS_FAILED = 4
"""Exit code where rows have failed; all others are written."""


@dataclass(frozen=True)
class CharactersCommand:
    """Drape a table of characters, one row after another in as many processes as there are processors, here or in a Ray
    cluster.

    Rows whose output is there are not done again, so the same command continues what was interrupted. A row that fails
    is named, and the others go on.
    """

    table: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TABLE")]
    """A .csv with the columns groom, motion and out, and if wanted frames, shape (ten numbers separated by spaces),
    stiffness, seed (of a bundled style) and body (a file of `quaffure body import`)."""
    draper: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(CLIP_DRAPERS)}}}")] = NEURAL
    """The network, or the solver, whose clips do not jump."""
    workers: int = 0
    """Processes; 0 is one for each processor. Each takes up to 2 GB."""
    ray: str = ""
    """Address of a running Ray cluster, such as auto or HOST:6379, whose machines have quaffure installed and the same
    files at the same paths; --workers is then how many rows it gets at once, 0 twice its processors."""
    retries: int = 1
    """How often a row is tried again that failed for another reason than its input."""
    json: bool = False
    """Print as JSON what was done."""

    def run(self) -> None:
        console.quiet = self.json
        if self.draper not in CLIP_DRAPERS:
            raise InputError("--draper", f"one of {', '.join(CLIP_DRAPERS)}", f"'{self.draper}'")
        for option, value in (("--workers", self.workers), ("--retries", self.retries)):
            if value < 0:
                raise InputError(option, "0 or more", f"{value}")
        rows = read_table(self.table)
        read = [source for row in rows for source in (row.groom, row.motion, row.body) if source]
        check_no_inputs(files_of(Path(row.out) for row in rows), read)
        for folder in {Path(row.out).parent for row in rows}:
            made_folder(folder, "a folder for drapes")
        check_outputs([Path(row.out) for row in rows], (self.table,))
        left = [row for row in rows if not Path(row.out).exists()]
        begin, failed = time.perf_counter(), {}
        workers, where = self._workers(len(left))
        console.print(f"{counted(len(rows), 'row')}, {len(rows) - len(left)} of them finished before; {where}")
        try:
            with progress_bar("draping", len(left), transient=True) as update:
                for finished in drape_rows(left, self.draper, workers, self.retries):
                    update(advance=1)
                    if finished.error:
                        failed[finished.row.out] = finished.error
                        console.print(f"{finished.row.out}: {finished.error}")
        finally:
            workers.close()
        seconds = time.perf_counter() - begin
        done = len(left) - len(failed)
        if self.json:
            print_json({"rows": len(rows), "written": done, "failed": failed, "seconds": seconds})
        console.print(f"written: {done} in {seconds:.1f} s; failed: {len(failed)}")
        if failed:
            sys.exit(ROWS_FAILED)

    def _workers(self, rows: int) -> tuple[RowWorkers, str]:
        """What drapes the rows, and what to say of it."""
        if self.ray:
            cluster = RayCluster(self.ray, self.workers)
            return cluster, f"a Ray cluster of {counted(cluster.processors, 'processor')}"
        count = min(self.workers or os.cpu_count() or 1, max(rows, 1))
        return LocalProcesses(count), counted(count, "process", "es")
