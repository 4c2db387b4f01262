"""A table of characters, a row each: what to drape and where to write it."""

import csv
import math
from collections import Counter
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import torch

from quaffure.apps.cli.outputs import check_frames
from quaffure.apps.drape_clip import drape_clip, save_drape
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.clips import CLIP_NAMES
from quaffure.body.motion import Motion
from quaffure.draper import Draper, LoadDependentDraper
from quaffure.drapers import NEURAL, STRAND_NEWTON, make_draper, with_coherence
from quaffure.energies.loading import Loading
from quaffure.errors import InputError, refused
from quaffure.hair.groom import Groom
from quaffure.input_file import check_input_file
from quaffure.io.load_groom import load_groom
from quaffure.io.load_motion import load_motion
from quaffure.procedural.generator import make_groom
from quaffure.procedural.hair_style import STYLES

CLIP_DRAPERS = (NEURAL, STRAND_NEWTON)
"""Drapers that are fast enough for clips of many characters."""
MOST_ROWS = 1_000_000
KEPT = 8
"""Grooms, motions and drapers that a process keeps for further rows."""


@dataclass(frozen=True, slots=True)
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

    def absolute(self) -> "CharacterRow":
        """The same row for a process in another folder."""
        groom = self.groom if self.groom in STYLES else str(Path(self.groom).absolute())
        motion = self.motion if self.motion in CLIP_NAMES else str(Path(self.motion).absolute())
        body = self.body and str(Path(self.body).absolute())
        return replace(self, groom=groom, motion=motion, out=str(Path(self.out).absolute()), body=body)


NAMES = tuple(field.name for field in fields(CharacterRow))
NEEDED = NAMES[:3]


def read_table(path: Path) -> list[CharacterRow]:
    """Rows of a .csv, whose first line names its columns.

    Raises:
        InputError: no such file, a column that is missing or not known, a line with more or fewer of them than needed,
            no rows or too many, or two rows with the same output.
    """
    check_input_file(path, "a table (.csv)")
    with (
        refused(path, "a table (.csv)", OSError, UnicodeDecodeError, csv.Error),
        path.open(newline="", encoding="utf-8-sig") as file,
    ):
        reader = csv.DictReader(file)
        columns = [column.strip() for column in reader.fieldnames or ()]
        if not {*NEEDED} <= {*columns} <= {*NAMES} or len({*columns}) < len(columns):
            expected = f"columns {', '.join(NEEDED)} and some of {', '.join(NAMES[3:])}"
            raise InputError(path, expected, ", ".join(map(repr, columns)) or "none")
        reader.fieldnames = columns
        rows = [_row(path, reader.line_num, line) for line in islice(reader, MOST_ROWS + 1)]
    if not 0 < len(rows) <= MOST_ROWS:
        raise InputError(path, f"1 to {MOST_ROWS} rows", f"more than {MOST_ROWS}" if rows else "none")
    ((out, times),) = Counter(row.out for row in rows).most_common(1)
    if times > 1:
        raise InputError(path, "a file of its own for each row", f"{out!r} {times} times")
    return rows


def _row(path: Path, number: int, line: dict[str | Any, str | Any]) -> CharacterRow:
    values = {name: text.strip() for name, text in line.items() if isinstance(text, str) and text.strip()}
    missing = [name for name in NEEDED if name not in values]
    if missing or None in line:  # where csv puts what has no column
        found = f"no {' and no '.join(missing)}" if missing else "more values than columns"
        raise InputError(f"{path}, line {number}", "a value for each column, all others empty", found)
    return CharacterRow(**values)


def drape_row(row: CharacterRow, draper: str) -> None:
    """Drape a row and write its output.

    Raises:
        InputError: what the row names cannot be read or draped, or its output not be written.
    """
    motion = _motion(row.motion, row.body).frames(row.frames)
    shape = torch.tensor([_number(row, "shape", text) for text in row.shape.split()] or [0.0] * 10)
    if len(shape) != 10:
        raise InputError(f"shape of {row.out}", "10 coefficients", f"{len(shape)}")
    seed = _number(row, "seed", row.seed)
    if not (seed.is_integer() and 0 <= seed < 2**32):
        raise InputError(f"seed of {row.out}", f"a whole number from 0 to {2**32 - 1}", f"'{row.seed}'")
    check_frames((Path(row.out),), range(len(motion)))
    groom, own_draper = (
        _groom(row.groom, int(seed), row.body),
        _draper(draper, _number(row, "stiffness", row.stiffness)),
    )
    body = _body(row.body)
    drape = drape_clip(groom, motion, shape, own_draper, body)
    is_own = body.origin is not None and row.motion not in CLIP_NAMES
    save_drape(drape, row.out, body=body, motion=row.motion if is_own else "")


@lru_cache(KEPT)
def _body(path: str) -> BodyModel:
    return load_body(path or None)


@lru_cache(KEPT)
def _groom(name: str, seed: int, body: str) -> Groom:
    return make_groom(name, _body(body), seed) if name in STYLES else load_groom(name, _body(body))


@lru_cache(KEPT)
def _motion(name: str, body: str) -> Motion:
    return load_motion(name, _body(body))


@lru_cache(KEPT)
def _draper(name: str, stiffness: float) -> Draper:
    loading = Loading(stiffness=stiffness)
    loading.check()
    return with_coherence(_standard_draper(name).with_loading(loading))


@lru_cache(len(CLIP_DRAPERS))
def _standard_draper(name: str) -> LoadDependentDraper:
    draper = make_draper(name)
    assert isinstance(draper, LoadDependentDraper)
    return draper


def _number(row: CharacterRow, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name} of {row.out}", "a number", f"'{text}'")
    return value
