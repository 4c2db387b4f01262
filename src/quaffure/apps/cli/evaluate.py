"""`quaffure evaluate`: every draper on the evaluation set, or on what a user brings."""

import importlib.util
import json
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.progress import Progress, TaskID, TimeElapsedColumn

from quaffure.apps.cli.console import console, print_json, print_rows, progress_columns
from quaffure.apps.cli.inputs import body_shape_of, motion_of
from quaffure.apps.cli.outputs import check_out
from quaffure.benchmark.comparison import DrapeFrame, compare
from quaffure.benchmark.drape_cache import DrapeCache, TimedDrape
from quaffure.benchmark.draping import CaseDraper
from quaffure.benchmark.evaluation_set import DataFolders, EvaluationCase, load_cases, load_evaluation_set
from quaffure.benchmark.methods import NETWORK, QUICK_ROWS, ROWS, methods
from quaffure.benchmark.report import mean_rows, worst_rows, write_report
from quaffure.benchmark.results import Results, results_of
from quaffure.benchmark.submissions import write_case
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.errors import InputError
from quaffure.io.atomic import made_folder, replacing
from quaffure.io.load_groom import load_groom

OWN_FRAMES = 3
"""Frames of a user's motion where none are asked for."""
DEFAULT_GROOM, DEFAULT_MOTION = "long_straight", "neck_turn"
MOTION_FOLDER, GROOM_FOLDER = Path("data/motion"), Path("data/grooms")
CACHE = Path("runs/evaluation")


@dataclass(frozen=True)
class Selection:
    """The cases of a run.

    Attributes:
        frames: how many drapes a row has to make.
        set_version: None where the cases are the user's.
        skipped: the file that is missing, by case.
    """

    cases: Iterable[EvaluationCase]
    frames: int
    set_version: int | None
    skipped: dict[str, str]


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare drapers by the figures of merit. Drapes are kept, so that a run that was stopped goes on where it was."""

    out: Path | None = None
    """The .json file of results to write."""
    report: Path | None = None
    """A folder for the results as a page, evaluation_results.md, with a picture."""
    quick: bool = False
    """A few cases of the set, and of the solvers xpbd alone: a minute or two."""
    draper: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A row to run; may be given several times. Without it, all, or those of --quick, and those of --weights."""
    weights: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME=FILE")] = ()
    """Weights of a training run as a row NAME; may be given several times. The row neural is the shipped weights;
    the row groomgen is those of `quaffure train-groomgen`, left out of cases of other grooms than its own."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A groom to evaluate on instead of the set; may be given several times."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A bundled clip or a file to evaluate on instead of the set; may be given several times."""
    frames: str = ""
    """With --groom or --motion: frames A:B:STEP of each motion at 30 frames per second; without it, three."""
    shape: str = ""
    """With --groom or --motion: ten shape coefficients, or a file of them; without it, the mean body."""
    cache: Path = CACHE
    """Folder that keeps the drapes."""
    motion_folder: Path = MOTION_FOLDER
    """Where the motion files of the set lie; cases whose files are missing are left out."""
    groom_folder: Path = GROOM_FOLDER
    """The same for its groom files."""
    write_cases: Path | None = None
    """Only write the cases of the set into this folder, for another method (see `quaffure score`)."""
    json: bool = False
    """Print the results as JSON instead of tables."""

    def run(self) -> None:
        self._check()
        begin = time.perf_counter()
        body, weights = load_body(), weights_by_name(self.weights)
        if self.write_cases is not None:
            self._write_cases(self.write_cases, body, weights)
            return
        rows = methods(self.draper or (*(QUICK_ROWS if self.quick else ROWS), *weights), weights)
        material = rows[0].draper.material
        selection = self._own(body) if self.groom or self.motion else self._of_set(body)
        draper = CaseDraper(body, DrapeCache(self.cache))
        with Progress(
            *progress_columns(TimeElapsedColumn()), console=console, transient=True, disable=self.json
        ) as progress:
            task = progress.add_task("loading", total=selection.frames * len(rows))
            by_name = {row.name: _watched(row.name, partial(draper.drape, row), progress, task) for row in rows}
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
        self._say_missing(results, [row.name for row in rows])
        self._tell(results)

    def _check(self) -> None:
        """Before the work and not after it."""
        if self.out is None and self.write_cases is None:
            raise InputError("--out", "a .json file to write", "none")
        if self.out is not None:
            check_out(self.out, ".json")
        own = {"--groom": self.groom, "--motion": self.motion}
        given = next((name for name, value in own.items() if value), None)
        if given and (self.quick or self.write_cases is not None):
            raise InputError(
                given, "no --quick and no --write-cases beside it: these take the set's own cases", own[given][0]
            )
        if not given and (self.frames or self.shape):
            option = "--frames" if self.frames else "--shape"
            raise InputError(option, "--groom or --motion beside it: the set has its own", self.frames or self.shape)

    def _of_set(self, body: BodyModel) -> Selection:
        of = load_evaluation_set()
        folders = DataFolders(self.motion_folder, self.groom_folder)
        entries = [entry for entry in of.cases if not self.quick or entry.name in of.quick]
        missing = {entry.name: folders.missing(entry, of) for entry in entries}
        there = [entry for entry in entries if missing[entry.name] is None]
        skipped = {name: path.name for name, path in missing.items() if path is not None}
        if skipped:
            self._say(f"{len(skipped)} of {len(entries)} cases left out: no {', '.join(sorted(set(skipped.values())))}")
        if not there:
            raise InputError("the evaluation", "at least one case whose files are there", "none")
        frames = sum(len(entry.frames) for entry in there)
        return Selection(load_cases(there, of, folders, body), frames, of.version, skipped)

    def _own(self, body: BodyModel) -> Selection:
        motions = [motion_of(name, body) for name in self.motion or (DEFAULT_MOTION,)]
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
        material = methods((NETWORK,), weights)[0].draper.material
        cases = self._of_set(body).cases
        made_folder(folder, "a folder for the cases")
        version = load_evaluation_set().version
        paths = [write_case(folder, case, version, body, material) for case in cases]
        print_json([str(path) for path in paths]) if self.json else self._say(
            f"written: {len(paths)} cases in {folder}"
        )

    def _tell(self, results: Results) -> None:
        assert self.out is not None
        with replacing(self.out) as beside:
            beside.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        written = [self.out, *(write_report(self.report, results) if self.report is not None else [])]
        if self.json:
            print_json(results)
            return
        print_summary(results)
        self._say(f"{results['drapes_made']} drapes made, {results['drapes_fetched']} found in {self.cache}")
        if self.report is not None and importlib.util.find_spec("matplotlib") is None:
            self._say("no picture without matplotlib: pip install 'quaffure\\[docs]'")
        self._say(f"written: {', '.join(map(str, written))}")

    def _announced(self, cases: Iterable[EvaluationCase]) -> Iterator[EvaluationCase]:
        """The cases, each told of where no terminal shows a bar."""
        for case in cases:
            if not console.is_terminal:
                self._say(f"{case.name}: {len(case.frames)} frames")
            yield case

    def _say_missing(self, results: Results, rows: list[str]) -> None:
        """Which rows had no answer to some cases."""
        if not results["summary"]["all"]:
            raise InputError("the evaluation", "a row that has an answer to every case", f"none of {', '.join(rows)}")
        cases = results["cases"]
        for row in rows:
            missing = sum(row not in case["figures"] for case in cases)
            if missing:
                self._say(f"{row} left out of {missing} of {len(cases)} cases: it was not trained on their grooms")

    def _say(self, line: str) -> None:
        """What is going on; not where the output is JSON for another program."""
        if not self.json:
            console.print(line)


def weights_by_name(pairs: tuple[str, ...]) -> dict[str, Path]:
    """Files by the name of their row.

    Raises:
        InputError: a pair without a name or without a file, or a name given twice.
    """
    weights: dict[str, Path] = {}
    for pair in pairs:
        name, _, path = pair.partition("=")
        if not name or not path or name in weights:
            raise InputError("--weights", "NAME=FILE, each NAME once", f"'{pair}'")
        weights[name] = Path(path)
    return weights


def print_summary(results: Results) -> None:
    """Means and worst frames over all cases."""
    everything = results["summary"]["all"]
    print_rows(_turned(mean_rows(everything)), f"{len(results['cases'])} cases, means; times are medians")
    print_rows(_turned(worst_rows(everything)), "worst frames")


def _turned(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """A row a figure of merit and a column a draper: a terminal is not wide enough for the figures' names."""
    figures = [key for key in rows[0] if key != "draper" and any(row[key] != "" for row in rows)]
    return [{"figure of merit": key} | {str(row["draper"]): row[key] for row in rows} for key in figures]


def _watched(name: str, drape_frame: DrapeFrame, progress: Progress, task: TaskID) -> DrapeFrame:
    def watched(case: EvaluationCase, frame: int) -> TimedDrape | None:
        progress.update(task, description=f"{name} on {case.name}, frame {case.frames[frame]}")
        drape = drape_frame(case, frame)
        progress.advance(task)
        return drape

    return watched


def _frames(motion: Motion, wanted: str) -> tuple[tuple[int, ...], Motion]:
    """Indices of the frames wanted, and the motion of those alone; three evenly spaced ones without a wish."""
    if not wanted:
        frames = tuple(sorted({(2 * part + 1) * len(motion) // (2 * OWN_FRAMES) for part in range(OWN_FRAMES)}))
        return frames, replace(motion, body_pose=motion.body_pose[list(frames)])
    chosen = motion.frames(wanted)
    first, step = int(wanted.strip().split(":")[0] or 0), round(motion.fps / chosen.fps)
    return tuple(range(first, first + step * len(chosen), step)), chosen
