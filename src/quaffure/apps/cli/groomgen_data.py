"""`quaffure groomgen-data`: a groom draped by a solver at random rotations of the neck, to supervise GroomGen by."""

import re
import time
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Annotated

import tyro
from rich.progress import Progress, TimeRemainingColumn

from quaffure.apps.cli.console import console, progress_columns
from quaffure.benchmark.evaluation_set import refuse_evaluation_data
from quaffure.body.body_model import load_body
from quaffure.errors import InputError
from quaffure.io.load_groom import load_groom
from quaffure.model.quaffure_model import load_model
from quaffure.solvers.by_name import SOLVERS, solver
from quaffure.training.groomgen_data import started_folder

LINE_EVERY = 60.0
"""Seconds between two lines that say how far it is, for logs without a terminal."""


@dataclass(frozen=True)
class GroomgenDataCommand:
    """Drape one groom at random neck rotations with a solver, for `quaffure train-groomgen`.

    Carries on where an earlier run in the folder stopped; more --poses later add to it. About 0.7 MB a pose.
    """

    groom: str
    """A bundled groom or a file. Grooms that are held out for evaluation are refused."""
    out: Path
    """Folder of the drapes; made where it does not exist."""
    poses: int = 1000
    """Poses in all."""
    draper: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(SOLVERS)}}}")] = "xpbd"
    """The solver, with its default setting (docs/solvers.md)."""
    seed: int = 0
    """Of the poses."""
    share: str = "1/1"
    """I/N: only every N-th pose, from the I-th on, for N processes at once in one folder."""

    def run(self) -> None:
        poses = self._poses()
        refuse_evaluation_data([self.groom])
        body = load_body()
        draper = solver(self.draper, load_model().draper.material)
        groom = load_groom(self.groom, body)
        refuse_evaluation_data([groom.name])
        folder = started_folder(self.out, groom, body, self.draper, draper, self.seed)
        missing = folder.missing(poses)
        console.print(f"{len(missing)} of {len(poses)} poses of {len(groom)} strands left to drape with {self.draper}")
        with Progress(*progress_columns(TimeRemainingColumn()), console=console) as progress:
            task = progress.add_task("draping", total=len(poses), completed=len(poses) - len(missing))
            start = told = time.monotonic()
            for done, pose in enumerate(missing, start=1):
                folder.drape(pose, draper)
                progress.advance(task)
                now = time.monotonic()
                if now - told > LINE_EVERY or done == len(missing):
                    each = (now - start) / done
                    left = timedelta(seconds=round(each * (len(missing) - done)))
                    console.print(f"{done} of {len(missing)} poses, {each:.1f} s each; {left} left")
                    told = now

    def _poses(self) -> range:
        """Numbers of the poses of this process."""
        if self.poses < 1:
            raise InputError("--poses", "1 or more", f"{self.poses}")
        if self.seed < 0:
            raise InputError("--seed", "0 or more", f"{self.seed}")
        part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", self.share)
        if part is None or not 1 <= int(part[1]) <= int(part[2]):
            raise InputError("--share", "I/N with I from 1 to N", f"'{self.share}'")
        return range(int(part[1]) - 1, self.poses, int(part[2]))
