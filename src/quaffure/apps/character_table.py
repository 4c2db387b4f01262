"""Many drapes from a table, on all processors: a row each, in processes of their own.

A row is finished when its output is there: files appear whole or not at all, so a run that was killed continues with
the rows that are left.
"""

import csv
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import torch
from numba import set_num_threads

from quaffure.apps.drape_clip import drape_clip, save_drape
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.draper import Draper
from quaffure.energies.loading import Loading
from quaffure.errors import InputError, refused
from quaffure.hair.groom import Groom
from quaffure.input_file import check_input_file
from quaffure.io.load_groom import load_groom
from quaffure.io.load_motion import load_motion
from quaffure.model.neural import NeuralDraper
from quaffure.model.quaffure_model import load_model
from quaffure.procedural.generator import make_groom
from quaffure.procedural.hair_style import STYLES
from quaffure.solvers.coherent_clip import CoherentDraper
from quaffure.solvers.strand_newton import StrandNewtonDraper

NEURAL, STRAND_NEWTON = "neural", "strand_newton"
DRAPERS = (NEURAL, STRAND_NEWTON)
MOST_ROWS = 1_000_000


@dataclass(frozen=True)
class CharacterRow:
    """A line of the table; its columns have these names.

    Attributes:
        groom: a bundled style or a file.
        motion: a bundled clip or a file.
        out: file to write.
        frames: A:B:STEP of the motion.
        shape: coefficients of the body, separated by spaces; the mean body where it is empty.
        stiffness: multiple of the hair's.
        seed: of a bundled style on the shipped body.
        body: a body file; the shipped body where it is empty.
    """

    groom: str
    motion: str
    out: str
    frames: str = ":"
    shape: str = ""
    stiffness: str = "1"
    seed: str = "0"
    body: str = ""


@dataclass(frozen=True)
class Finished:
    """What became of a row: without an error, its output is there."""

    row: CharacterRow
    error: str = ""


def read_table(path: Path) -> list[CharacterRow]:
    """Rows of a .csv, whose first line names its columns.

    Raises:
        InputError: no such file, a column that is missing or not known, no rows, or two rows with the same output.
    """
    check_input_file(path, "a table (.csv)")
    names = [field.name for field in fields(CharacterRow)]
    with refused(path, "a table (.csv)", OSError, UnicodeDecodeError, csv.Error), path.open(newline="") as file:
        reader = csv.DictReader(file)
        columns = [column.strip() for column in reader.fieldnames or ()]
        reader.fieldnames = columns
        lines = [line for _, line in zip(range(MOST_ROWS), reader)]
    if not {"groom", "motion", "out"} <= set(columns) <= set(names):
        raise InputError(path, f"columns groom, motion, out and some of {', '.join(names[3:])}", ", ".join(columns))
    rows = [
        CharacterRow(**{name: text.strip() for name, text in line.items() if text and text.strip()}) for line in lines
    ]
    if not rows:
        raise InputError(path, "at least one row", "none")
    outputs = [row.out for row in rows]
    again = next((out for out in outputs if outputs.count(out) > 1), None) if len(set(outputs)) < len(rows) else None
    if again is not None:
        raise InputError(path, "a file of its own for each row", f"{again} twice")
    return rows


def drape_rows(rows: Sequence[CharacterRow], draper: str, workers: int, retries: int = 1) -> Iterator[Finished]:
    """Drape the rows, each as soon as a process is free; yields each when it is finished or has failed for good.

    A row that its input makes impossible fails at once; any other error, and a process that ended, is tried again.

    Args:
        draper: one of `DRAPERS`.
        workers: processes.
        retries: how often a row is tried again.
    """
    left = [*rows]
    for attempt in range(retries + 1):
        again: list[CharacterRow] = []
        with _pool(workers) as pool:
            futures = {pool.submit(_tried, row, draper): row for row in left}
            for future in as_completed(futures):
                error, is_final = _outcome(future)
                if error and not is_final and attempt < retries:
                    again.append(futures[future])
                else:
                    yield Finished(futures[future], error)
        left = again


def _pool(workers: int) -> ProcessPoolExecutor:
    # Forked children of a process with threads may hang.
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _use_one_thread)


def _use_one_thread() -> None:
    torch.set_num_threads(1)
    set_num_threads(1)


def _tried(row: CharacterRow, draper: str) -> tuple[str, bool]:
    """The error of a row, empty without one, and whether another try would end alike."""
    try:
        drape_row(row, draper)
    except InputError as error:
        return str(error), True
    except Exception as error:  # whatever it is, the other rows go on
        return f"{type(error).__name__}: {error}", False
    return "", False


def _outcome(future: "Future[tuple[str, bool]]") -> tuple[str, bool]:
    try:
        return future.result()
    except BrokenProcessPool:
        return "a process ended, for want of memory perhaps", False


def drape_row(row: CharacterRow, draper: str) -> None:
    """Drape a row and write its output.

    Raises:
        InputError: what the row names cannot be read or draped, or its output not be written.
    """
    motion = _motion(row.motion, row.body).frames(row.frames)
    shape = torch.tensor([_float(row, "shape", text) for text in row.shape.split()] or [0.0] * 10)
    if len(shape) != 10:
        raise InputError(f"shape of {row.out}", "10 coefficients", f"{len(shape)}")
    groom = _groom(row.groom, int(_number(row, "seed")), row.body)
    own_draper = _draper(draper, _number(row, "stiffness"))
    hair = drape_clip(groom, motion, shape, own_draper, _body(row.body))
    save_drape(hair, row.out, body=_body(row.body))


@cache
def _body(path: str) -> BodyModel:
    return load_body(path or None)


@cache
def _groom(name: str, seed: int, body: str) -> Groom:
    return make_groom(name, load_body(), seed) if name in STYLES and not body else load_groom(name, _body(body))


@cache
def _motion(name: str, body: str) -> Motion:
    return load_motion(name, _body(body))


@cache
def _draper(name: str, stiffness: float) -> Draper:
    loading = Loading(stiffness=stiffness)
    loading.check()
    if name == NEURAL:
        return _network().under(loading)
    return CoherentDraper(StrandNewtonDraper().under(loading))


@cache
def _network() -> NeuralDraper:
    return load_model().draper


def _number(row: CharacterRow, name: str) -> float:
    return _float(row, name, getattr(row, name))


def _float(row: CharacterRow, name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name} of {row.out}", "a number", f"'{text}'") from None
