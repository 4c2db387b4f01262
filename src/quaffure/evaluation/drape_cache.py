"""Drapes on disk, so that an evaluation goes on where it was stopped and never drapes the same frame twice."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from quaffure.errors import InputError
from quaffure.io.atomic import made_folder, replacing
from quaffure.io.npz_strands import read_npz
from quaffure.types import Float, Tensor


@dataclass(frozen=True)
class TimedDrape:
    """One frame, draped.

    Attributes:
        strands: draped vertices [m, world].
        milliseconds: wall time of this drape, from pose in to strands out; None where nobody took it.
        machine: what took that time.
    """

    strands: Float[Tensor, "s n 3"]
    milliseconds: float | None
    machine: str = ""


@dataclass(frozen=True)
class DrapeNote:
    """What the .json file beside a drape says of it.

    Attributes:
        frame: of the clip.
        milliseconds, machine: as in `TimedDrape`.
    """

    case: str
    frame: int
    draper: str
    milliseconds: float | None
    machine: str


class DrapeCache:
    """A folder of drapes by fingerprint: `<key>.npz`, and `<key>.json` that says what it is.

    A drape counts once its note is there, which is written last: a process that dies in between leaves nothing
    half-written. Processes may share a folder, as none of its files belongs to more than one drape.

    Raises:
        InputError: the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = made_folder(folder, "a folder for drapes")

    def get(self, key: str) -> TimedDrape | None:
        """The drape of a fingerprint; None where there is none, or where one of its files is lost or damaged."""
        note = _read_note(self._path(key, ".json"))
        if note is None:
            return None
        try:
            strands = read_npz(self._path(key, ".npz"), ("strands",)).get("strands")
        except InputError:
            return None
        if strands is None or strands.dtype != np.float32:
            return None
        return TimedDrape(torch.from_numpy(strands), note.milliseconds, note.machine)

    def put(self, key: str, drape: TimedDrape, case: str, frame: int, draper: str) -> None:
        note = DrapeNote(case, frame, draper, drape.milliseconds, drape.machine)
        with replacing(self._path(key, ".npz")) as temporary, temporary.open("wb") as file:
            np.savez(file, strands=drape.strands.numpy())
        with replacing(self._path(key, ".json")) as temporary:
            temporary.write_text(json.dumps(asdict(note), indent=1) + "\n", encoding="utf-8")

    def _path(self, key: str, suffix: str) -> Path:
        return self.folder / f"{key}{suffix}"


def _read_note(path: Path) -> DrapeNote | None:
    try:
        return DrapeNote(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
