"""`quaffure score`: drapes of another method, by the metrics of `quaffure evaluate`."""

from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.cli.console import console, print_json
from quaffure.apps.cli.evaluate import EvaluationOptions, print_summary
from quaffure.benchmark.comparison import DrapeFrame, compare
from quaffure.benchmark.drape_cache import TimedDrape
from quaffure.benchmark.evaluation_set import EvaluationCase, load_cases, load_evaluation_set
from quaffure.benchmark.methods import ROWS, methods
from quaffure.benchmark.results import Results, results_of
from quaffure.benchmark.submissions import read_submission, submitted_frames
from quaffure.body.body_model import load_body
from quaffure.config import HairMaterial
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence


@dataclass(frozen=True)
class ScoreCommand:
    """Measure drape files for the cases of `quaffure evaluate --write-cases`, next to the rows already draped."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE...")]
    """Drape files (.npz), one a case."""
    name: str = "answer"
    """Name of the method."""
    json: bool = False
    """Print the results as JSON instead of tables."""
    options: EvaluationOptions = field(default_factory=EvaluationOptions)

    def run(self) -> None:
        console.quiet = self.json
        if not self.files:
            raise InputError("score", "at least one drape file", "none")
        weights = self.options.weights_by_row()
        rows = methods((*ROWS, *weights), weights)
        if self.name in [row.name for row in rows]:
            raise InputError("--name", "a name that no other row has", f"'{self.name}'")
        material = rows[0].draper.material
        drapes = self._read(material)
        evaluation_set, body = load_evaluation_set(), load_body()
        draper = self.options.case_draper(body)

        @cache
        def frames(case: EvaluationCase) -> list[TimedDrape]:
            return submitted_frames(*drapes[case.name], case, body)

        by_name: dict[str, DrapeFrame] = {self.name: lambda case, frame: frames(case)[frame]}
        by_name |= {row.name: partial(draper.known, row) for row in rows}
        entries = [entry for entry in evaluation_set.cases if entry.name in drapes]
        cases = load_cases(entries, evaluation_set, self.options.folders, body)
        compared = compare(cases, by_name, [row.name for row in rows if row.is_solver], body, material)
        about = {"evaluation_set": evaluation_set.version, "drapes_fetched": draper.fetched}
        self._print(results_of(compared, rows, material, about))

    def _read(self, material: HairMaterial) -> dict[str, tuple[Path, DrapeSequence]]:
        """File and drape by the name of the case."""
        evaluation_set = load_evaluation_set()
        drapes: dict[str, tuple[Path, DrapeSequence]] = {}
        for path in self.files:
            entry, sequence = read_submission(path, evaluation_set, material)
            missing = self.options.folders.missing(entry, evaluation_set)
            if missing is not None:
                raise InputError(path, f"{missing}, which its case needs", "no such file")
            if entry.name in drapes:
                raise InputError(path, f"one drape of {entry.name}", f"another in {drapes[entry.name][0]}")
            drapes[entry.name] = path, sequence
        return drapes

    def _print(self, results: Results) -> None:
        if self.json:
            print_json(results)
        print_summary(results)
        without = [case["case"] for case in results["cases"] if not case["reference"]]
        if without:
            console.print(f"no reference for {', '.join(without)}: `quaffure evaluate` has not draped them yet")
