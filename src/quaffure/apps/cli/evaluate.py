"""`quaffure evaluate`: every draper on the evaluation set, or on grooms and motions of the user. `quaffure score`: the
drapes of another method.
"""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.cli.console import Update, console, print_json, print_rows, progress_bar
from quaffure.apps.cli.inputs import body_shape_of, motion_of
from quaffure.benchmark.comparison import DrapeFrame, compare
from quaffure.benchmark.drape_cache import DrapeCache, TimedDrape
from quaffure.benchmark.draping import CaseDraper
from quaffure.benchmark.evaluation_set import SETS, DataFolders, EvaluationCase, load_cases, load_evaluation_set
from quaffure.benchmark.methods import QUICK_ROWS, ROWS, methods
from quaffure.benchmark.report import headline, mean_rows, worst_rows, write_report
from quaffure.benchmark.results import Results, results_of
from quaffure.benchmark.submissions import read_submission, submitted_frames, write_case
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.config import HairMaterial
from quaffure.drapers import NEURAL
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.io.atomic import write_json
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output, check_output_folder, made_folder

OWN_FRAMES = 3
"""Number of frames of a user's motion without --frames."""
DEFAULT_GROOM, DEFAULT_MOTION = "long_straight", "neck_turn"


@dataclass(frozen=True)
class Selection:
    """The cases of a run.

    Attributes:
        frames: number of drapes a row has to make.
        set_version: None for cases of the user.
        skipped: name of the missing file, by case.
    """

    cases: Iterable[EvaluationCase]
    frames: int
    set_version: int | None
    skipped: dict[str, str]


@dataclass(frozen=True)
class EvaluationOptions:
    """Options that `quaffure score` has as well: weights of networks, folders of drapes, motions and grooms."""

    weights: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME=FILE")] = ()
    """Weights of a training run as a row NAME; may be given several times. The row neural is the shipped weights;
    the row groomgen is those of `quaffure train-groomgen`, left out of cases of other grooms than its own."""
    cache: Path = Path("runs/evaluation")
    """Folder that keeps the drapes of `quaffure evaluate`."""
    set: int = SETS[-1]
    """Version of the evaluation set."""
    motion_folder: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """Folder of the set's motion files; may be given several times; without it, data/motion_evaluation and data/motion.
    Cases whose files are missing are left out by `quaffure evaluate`."""
    groom_folder: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """The same for the set's groom files; without it, data/grooms_evaluation and data/grooms."""

    @property
    def folders(self) -> DataFolders:
        motions = self.motion_folder or (Path("data/motion_evaluation"), Path("data/motion"))
        return DataFolders(motions, self.groom_folder or (Path("data/grooms_evaluation"), Path("data/grooms")))

    def case_draper(self, body: BodyModel) -> CaseDraper:
        return CaseDraper(body, DrapeCache(self.cache))

    def weights_by_row(self) -> dict[str, Path]:
        """Files by the name of their row.

        Raises:
            InputError: a pair without a name or without a file, or a name given twice.
        """
        weights: dict[str, Path] = {}
        for pair in self.weights:
            name, _, path = pair.partition("=")
            if not name or not path or name in weights:
                raise InputError("--weights", "NAME=FILE, each NAME once", f"'{pair}'")
            weights[name] = Path(path)
        return weights


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare drapers by all metrics. Drapes are kept, so that a run that was stopped continues where it was."""

    out: Path | None = None
    """The .json file of results to write."""
    report: Path | None = None
    """A folder for the results as a page, evaluation_results.md, with a picture."""
    quick: bool = False
    """A few cases of the set, and of the solvers strand_newton alone: a minute or two."""
    draper: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A row to run; may be given several times. Without it, all, or those of --quick, and those of --weights."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A groom to evaluate on instead of the set; may be given several times."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled clip or a file to evaluate on instead of the set; may be given several times."""
    frames: str = ""
    """With --groom or --motion: frames A:B:STEP of each motion at 30 frames per second; without it, three."""
    shape: str = ""
    """With --groom or --motion: ten shape coefficients, or a file of them; without it, the mean body."""
    write_cases: Path | None = None
    """Only write the cases of the set into this folder, for another method (see `quaffure score`)."""
    json: bool = False
    """Print the results as JSON instead of tables."""
    shared: EvaluationOptions = field(default_factory=EvaluationOptions)

    def run(self) -> None:
        self._check()
        console.quiet = self.json
        begin = time.perf_counter()
        body, weights = load_body(), self.shared.weights_by_row()
        if self.write_cases is not None:
            self._write_cases(self.write_cases, body, weights)
            return
        rows = methods(self.draper or (*(QUICK_ROWS if self.quick else ROWS), *weights), weights)
        material = rows[0].draper.material
        selection = self._user_cases(body) if self.groom or self.motion else self._set_cases(body)
        draper = self.shared.case_draper(body)
        total = selection.frames * len(rows)
        with progress_bar("loading", total, transient=True) as update:
            by_name = {row.name: partial(_drape, row.name, partial(draper.drape, row), update) for row in rows}
            solvers = [row.name for row in rows if row.is_solver]
            compared = compare(self._announced(selection.cases), by_name, solvers, body, material)
        about = {
            "evaluation_set": selection.set_version,
            "quick": self.quick,
            "skipped": selection.skipped,
            "seconds": time.perf_counter() - begin,
            "drapes_made": draper.made,
            "drapes_fetched": draper.fetched,
        }
        results = results_of(compared, rows, material, about)
        self._print_missing(results, [row.name for row in rows])
        self._write(results)

    def _check(self) -> None:
        """Refuse options before the work."""
        if self.out is None and self.write_cases is None:
            raise InputError("--out", "a .json file to write", "none")
        if self.out is not None:
            weights = self.shared.weights_by_row().values()
            inputs: list[str | Path | None] = [*self.groom, *self.motion, self.shape, *weights]
            check_output(self.out, ".json", inputs=inputs)
        folders = {"the report": self.report, "the cases": self.write_cases}
        for what, folder in folders.items():
            if folder is not None:
                check_output_folder(folder, f"a folder for {what}")
        own = {"--groom": self.groom, "--motion": self.motion}
        given = next((name for name, value in own.items() if value), None)
        if given and (self.quick or self.write_cases is not None):
            expected = "no --quick and no --write-cases with it: these take the cases of the set"
            raise InputError(given, expected, own[given][0])
        if not given and (self.frames or self.shape):
            option = "--frames" if self.frames else "--shape"
            raise InputError(option, "--groom or --motion with it: the set has its own", self.frames or self.shape)

    def _set_cases(self, body: BodyModel) -> Selection:
        evaluation_set, folders = load_evaluation_set(self.shared.set), self.shared.folders
        entries = [entry for entry in evaluation_set.cases if not self.quick or entry.name in evaluation_set.quick]
        missing = {entry.name: folders.missing(entry, evaluation_set) for entry in entries}
        complete = [entry for entry in entries if missing[entry.name] is None]
        skipped = {name: path.name for name, path in missing.items() if path is not None}
        if skipped:
            console.print(
                f"{len(skipped)} of {len(entries)} cases left out: no {', '.join(sorted(set(skipped.values())))}"
            )
        if not complete:
            raise InputError("the evaluation", "at least one case whose files are there", "none")
        cases = load_cases(complete, evaluation_set, folders, body)
        return Selection(cases, sum(len(entry.frames) for entry in complete), evaluation_set.version, skipped)

    def _user_cases(self, body: BodyModel) -> Selection:
        motions = [motion_of(name, body, in_place=True) for name in self.motion or (DEFAULT_MOTION,)]
        grooms = [load_groom(name, body) for name in self.groom or (DEFAULT_GROOM,)]
        shape = body_shape_of(self.shape)
        cases = []
        for motion in motions:
            frames, chosen = _frames(motion, self.frames)
            for groom in grooms:
                name = f"{groom.name}-{motion.name}"
                cases.append(EvaluationCase(name, "own", self.shape or "mean", groom, chosen, frames, shape))
        return Selection(cases, sum(len(case.frames) for case in cases), None, {})

    def _write_cases(self, folder: Path, body: BodyModel, weights: dict[str, Path]) -> None:
        material = methods((NEURAL,), weights)[0].draper.material
        cases = self._set_cases(body).cases
        made_folder(folder, "a folder for the cases")
        version = load_evaluation_set(self.shared.set).version
        paths = [write_case(folder, case, version, body, material) for case in cases]
        if self.json:
            print_json([str(path) for path in paths])
        console.print(f"written: {len(paths)} cases in {folder}")

    def _write(self, results: Results) -> None:
        assert self.out is not None
        write_json(self.out, results)
        written = [self.out, *(write_report(self.report, results) if self.report is not None else [])]
        if self.json:
            print_json(results)
        print_summary(results)
        console.print(
            f"{results['drapes_made']} drapes made, {results['drapes_fetched']} read from {self.shared.cache}"
        )
        if len(written) == 2:
            console.print("no picture without matplotlib: pip install 'quaffure[docs]'")
        console.print(f"written: {', '.join(map(str, written))}")

    def _announced(self, cases: Iterable[EvaluationCase]) -> Iterator[EvaluationCase]:
        """The cases; prints a line for each if no terminal shows a bar."""
        for case in cases:
            if not console.is_terminal:
                console.print(f"{case.name}: {len(case.frames)} frames")
            yield case

    def _print_missing(self, results: Results, rows: list[str]) -> None:
        """Print which rows have no drape of some cases."""
        if not results["summary"]["all"]:
            raise InputError("the evaluation", "a row that drapes every case", f"none of {', '.join(rows)}")
        cases = results["cases"]
        for row in rows:
            missing = sum(row not in case["figures"] for case in cases)
            if missing:
                console.print(f"{row} left out of {missing} of {len(cases)} cases: it was not trained on their grooms")


@dataclass(frozen=True)
class ScoreCommand:
    """Measure drape files for the cases of `quaffure evaluate --write-cases`, next to the rows already draped."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE...")]
    """Drape files (.npz), one a case."""
    name: str = "submission"
    """Name of the method."""
    json: bool = False
    """Print the results as JSON instead of tables."""
    shared: EvaluationOptions = field(default_factory=EvaluationOptions)

    def run(self) -> None:
        console.quiet = self.json
        if not self.files:
            raise InputError("score", "at least one drape file", "none")
        weights = self.shared.weights_by_row()
        rows = methods((*ROWS, *weights), weights)
        if self.name in [row.name for row in rows]:
            raise InputError("--name", "a name that no other row has", f"'{self.name}'")
        material = rows[0].draper.material
        drapes = self._read(material)
        evaluation_set, body = load_evaluation_set(self.shared.set), load_body()
        draper = self.shared.case_draper(body)

        @cache
        def frames(case: EvaluationCase) -> list[TimedDrape]:
            return submitted_frames(*drapes[case.name], case, body)

        by_name: dict[str, DrapeFrame] = {self.name: lambda case, frame: frames(case)[frame]}
        by_name |= {row.name: partial(draper.known, row) for row in rows}
        entries = [entry for entry in evaluation_set.cases if entry.name in drapes]
        cases = load_cases(entries, evaluation_set, self.shared.folders, body)
        compared = compare(cases, by_name, [row.name for row in rows if row.is_solver], body, material)
        about = {"evaluation_set": evaluation_set.version, "drapes_fetched": draper.fetched}
        self._print(results_of(compared, rows, material, about))

    def _read(self, material: HairMaterial) -> dict[str, tuple[Path, DrapeSequence]]:
        """File and drape by the name of the case."""
        evaluation_set = load_evaluation_set(self.shared.set)
        drapes: dict[str, tuple[Path, DrapeSequence]] = {}
        for path in self.files:
            entry, sequence = read_submission(path, evaluation_set, material)
            missing = self.shared.folders.missing(entry, evaluation_set)
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


def print_summary(results: Results) -> None:
    """Means and worst frames over all cases, or over those of free hair."""
    rows, hair = headline(results["summary"])
    print_rows(_transposed(mean_rows(rows)), f"{len(results['cases'])} cases, means{hair}; times are medians")
    print_rows(_transposed(worst_rows(rows)), "worst frames")


def _transposed(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """One row a metric and one column a draper: a terminal is not wide enough for the names of all metrics."""
    metrics = [key for key in rows[0] if key != "draper" and any(row[key] != "" for row in rows)]
    return [{"metric": key} | {str(row["draper"]): row[key] for row in rows} for key in metrics]


def _drape(name: str, drape_frame: DrapeFrame, update: Update, case: EvaluationCase, frame: int) -> TimedDrape | None:
    update(description=f"{name} on {case.name}, frame {case.frames[frame]}")
    drape = drape_frame(case, frame)
    update(advance=1)
    return drape


def _frames(motion: Motion, wanted: str) -> tuple[tuple[int, ...], Motion]:
    """Indices of the frames `wanted`, and the motion of those alone; three evenly spaced ones if it is empty."""
    if not wanted:
        frames = tuple(sorted({(2 * part + 1) * len(motion) // (2 * OWN_FRAMES) for part in range(OWN_FRAMES)}))
        return frames, replace(motion, body_pose=motion.body_pose[list(frames)])
    chosen = motion.frames(wanted)
    first, step = int(wanted.strip().split(":")[0] or 0), round(motion.fps / chosen.fps)
    return tuple(range(first, first + step * len(chosen), step)), chosen
