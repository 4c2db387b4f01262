"""`quaffure score`: drapes of a method from elsewhere, by the figures that `quaffure evaluate` gives its own rows."""

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.cli.console import console, print_json
from quaffure.apps.cli.evaluate import CACHE, GROOM_FOLDER, MOTION_FOLDER, print_summary, weights_by_name
from quaffure.benchmark.comparison import DrapeFrame, compare
from quaffure.benchmark.drape_cache import DrapeCache, TimedDrape
from quaffure.benchmark.draping import CaseDraper
from quaffure.benchmark.evaluation_set import DataFolders, EvaluationCase, load_cases, load_evaluation_set
from quaffure.benchmark.methods import ROWS, methods
from quaffure.benchmark.results import Results, results_of
from quaffure.benchmark.submissions import read_submission, submitted_frames
from quaffure.body.body_model import load_body
from quaffure.config import HairMaterial
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence


@dataclass(frozen=True)
class ScoreCommand:
    """Score drape files that answer the cases of `quaffure evaluate --write-cases`, beside the rows already draped."""

    answers: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE...")]
    """Drape files (.npz), one a case."""
    name: str = "answer"
    """What to call the method."""
    weights: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME=FILE")] = ()
    """Further rows, as `quaffure evaluate` was given them."""
    cache: Path = CACHE
    """Folder that keeps the drapes of `quaffure evaluate`."""
    motion_folder: Path = MOTION_FOLDER
    """Where the motion files of the set lie."""
    groom_folder: Path = GROOM_FOLDER
    """The same for its groom files."""
    json: bool = False
    """Print the results as JSON instead of tables."""

    def run(self) -> None:
        if not self.answers:
            raise InputError("score", "at least one drape file", "none")
        weights = weights_by_name(self.weights)
        rows = methods((*ROWS, *weights), weights)
        if self.name in [row.name for row in rows]:
            raise InputError("--name", "a name that no other row has", f"'{self.name}'")
        material = rows[0].draper.material
        answers = self._read(material)
        of, body = load_evaluation_set(), load_body()
        draper = CaseDraper(body, DrapeCache(self.cache))

        @cache
        def frames(case: EvaluationCase) -> list[TimedDrape]:
            return submitted_frames(*answers[case.name], case, body)

        by_name: dict[str, DrapeFrame] = {self.name: lambda case, frame: frames(case)[frame]}
        by_name |= {row.name: partial(draper.known, row) for row in rows}
        cases = load_cases([entry for entry in of.cases if entry.name in answers], of, self._folders, body)
        compared = compare(cases, by_name, [row.name for row in rows if row.is_solver], body, material)
        about = {"evaluation_set": of.version, "drapes_fetched": draper.fetched}
        self._tell(results_of(compared, rows, material, about))

    @property
    def _folders(self) -> DataFolders:
        return DataFolders(self.motion_folder, self.groom_folder)

    def _read(self, material: HairMaterial) -> dict[str, tuple[Path, DrapeSequence]]:
        """File and drape by the name of the case."""
        of = load_evaluation_set()
        answers: dict[str, tuple[Path, DrapeSequence]] = {}
        for path in self.answers:
            entry, sequence = read_submission(path, of, material)
            missing = self._folders.missing(entry, of)
            if missing is not None:
                raise InputError(path, f"{missing}, which its case needs", "no such file")
            if entry.name in answers:
                raise InputError(path, f"one answer to {entry.name}", f"another in {answers[entry.name][0]}")
            answers[entry.name] = path, sequence
        return answers

    def _tell(self, results: Results) -> None:
        if self.json:
            print_json(results)
            return
        print_summary(results)
        without = [case["case"] for case in results["cases"] if not case["reference"]]
        if without:
            console.print(f"no reference for {', '.join(without)}: `quaffure evaluate` has not draped them yet")
