"""`quaffure groomgen-data` and `quaffure train-groomgen`: the supervised baseline, from drapes made by a solver."""

import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.cli.console import TimeLeft, console, progress_bar, run_training
from quaffure.benchmark.evaluation_set import refuse_evaluation_data
from quaffure.body.body_model import load_body
from quaffure.energies.by_name import hair_terms
from quaffure.errors import InputError
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output_folder
from quaffure.model.quaffure_model import load_model
from quaffure.solvers.by_name import SOLVERS, solver
from quaffure.solvers.strand_newton import StrandNewtonDraper
from quaffure.training.groomgen_data import DRAPES, DrapeFolder, started_folder
from quaffure.training.loop import Training
from quaffure.training.run_folder import RUN
from quaffure.training.train_groomgen import GroomGenConfig, GroomGenRecipe

SECONDS_BETWEEN_LINES = 60.0
"""Lines about the progress are for logs without a terminal."""


@dataclass(frozen=True)
class GroomgenDataCommand:
    """Drape one groom at random neck rotations with a solver, for `quaffure train-groomgen`.

    Continues where an earlier run in the folder stopped; more --poses later add to it. About 0.7 MB a pose.
    """

    groom: str
    """A bundled groom or a file. Grooms that are held out for evaluation are refused."""
    out: Path
    """Folder of the drapes; made if it does not exist."""
    poses: int = 1000
    """Number of poses in all."""
    draper: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(SOLVERS)}}}")] = "xpbd"
    """The solver, with its default setting (docs/solvers.md), on the paper's energy; strand_newton on the rod's."""
    seed: int = 0
    """Seed of the poses."""
    share: str = "1/1"
    """I/N: only every N-th pose, from the I-th on, for N processes at once in one folder."""

    def run(self) -> None:
        poses = self._poses()
        check_output_folder(self.out, DRAPES)
        refuse_evaluation_data([self.groom])
        body = load_body()
        # As in docs/groomgen.md: the paper's energy, which strand_newton alone does not minimize.
        terms = None if self.draper == StrandNewtonDraper.name else hair_terms()
        draper = solver(self.draper, load_model().draper.material, terms)
        groom = load_groom(self.groom, body)
        refuse_evaluation_data([groom.name])
        folder = started_folder(self.out, groom, body, self.draper, draper, self.seed)
        missing = folder.missing(poses)
        console.print(f"{len(missing)} of {len(poses)} poses of {len(groom)} strands left to drape with {self.draper}")
        left, printed = TimeLeft(len(missing)), time.monotonic()
        with progress_bar("draping", len(poses), len(poses) - len(missing)) as update:
            for done, pose in enumerate(missing, start=1):
                folder.drape(pose, draper)
                update(advance=1)
                if time.monotonic() - printed > SECONDS_BETWEEN_LINES or done == len(missing):
                    console.print(f"{done} of {len(missing)} poses; {left.at(done)} left")
                    printed = time.monotonic()

    def _poses(self) -> range:
        """Indices of the poses of this process."""
        if self.poses < 1:
            raise InputError("--poses", "1 or more", f"{self.poses}")
        if self.seed < 0:
            raise InputError("--seed", "0 or more", f"{self.seed}")
        part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", self.share)
        if part is None or not 1 <= int(part[1]) <= int(part[2]):
            raise InputError("--share", "I/N with I from 1 to N", f"'{self.share}'")
        return range(int(part[1]) - 1, self.poses, int(part[2]))


@dataclass(frozen=True)
class TrainGroomgenCommand:
    """Train GroomGen's neural simulator on the drapes of `quaffure groomgen-data`; continues where it stopped.

    The folder then holds `best.safetensors`, the weights to drape with (`quaffure drape --draper groomgen --weights`),
    `config.json`, the table `validation.csv`, and the checkpoint to continue from.
    """

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATA")]
    """Folder that `quaffure groomgen-data` filled. A tenth of its poses is for validation."""
    out: Path
    """Folder of the run; made if it does not exist."""
    config: GroomGenConfig = field(default_factory=GroomGenConfig)

    def run(self) -> None:
        check_output_folder(self.out, RUN)
        folder = DrapeFolder(self.data, load_body())
        with progress_bar(f"reading drapes of {folder.manifest.groom}", None) as update:
            drapes = folder.read(lambda poses: update(completed=poses))
            update(total=len(drapes))
        run_training(Training(GroomGenRecipe(self.config, folder, drapes), self.out), _bar_text, _validation_text)


def _bar_text(values: dict[str, float]) -> str:
    return f"training, {values['train_rms_mm']:.2f} mm rms"


def _validation_text(values: dict[str, float]) -> str:
    if "distance_mm" not in values:
        return ""
    posed = f"(posed: {values['posed_distance_mm']:.2f} mm)"
    return f"{values['distance_mm']:.2f} mm from the solver on poses not trained on {posed}"
