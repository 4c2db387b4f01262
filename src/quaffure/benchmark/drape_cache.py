"""Drapes on disk, so that an evaluation goes on where it was stopped and never drapes the same frame twice."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from quaffure.benchmark.fingerprint import fingerprint
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.atomic import made_folder, replacing
from quaffure.npz_file import read_npz
from quaffure.types import Float, Tensor

SAME_GROOM = 1e-5
"""Grooms are the same where no vertex [m] and no root [in the scalp's chart] differs by more."""


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
    """A folder of drapes by fingerprint: `<key>.npz`, and `<key>.json` that says what it is; grooms in `grooms`.

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
        strands = _read_arrays(self._path(key, ".npz"), ("strands",)).get("strands")
        if strands is None or strands.dtype != np.float32:
            return None
        return TimedDrape(torch.from_numpy(strands), note.milliseconds, note.machine)

    def put(self, key: str, drape: TimedDrape, case: str, frame: int, draper: str) -> None:
        note = DrapeNote(case, frame, draper, drape.milliseconds, drape.machine)
        with replacing(self._path(key, ".npz")) as temporary, temporary.open("wb") as file:
            np.savez(file, strands=drape.strands.numpy())
        with replacing(self._path(key, ".json")) as temporary:
            temporary.write_text(json.dumps(asdict(note), indent=1) + "\n", encoding="utf-8")

    def groom_key(self, groom: Groom) -> str:
        """Fingerprint of the groom in this folder that is the same within `SAME_GROOM`; where there is none, of this
        one, which the folder keeps.

        No groom is the same to the last bit on another processor, with another number of threads or freshly compiled.
        """
        strands, root_uv = groom.rest_strands.numpy(), groom.root_uv.numpy()
        folder = made_folder(self.folder / "grooms", "a folder for grooms")
        for path in sorted(folder.glob("*.npz")):
            kept = _read_arrays(path, ("rest_strands", "root_uv"))
            if _same(kept.get("rest_strands"), strands) and _same(kept.get("root_uv"), root_uv):
                return path.stem
        key = fingerprint(strands, root_uv)
        with replacing(folder / f"{key}.npz") as temporary, temporary.open("wb") as file:
            np.savez(file, rest_strands=strands, root_uv=root_uv)
        return key

    def _path(self, key: str, suffix: str) -> Path:
        return self.folder / f"{key}{suffix}"


def _read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Nothing of a file that is lost or damaged."""
    try:
        return read_npz(path, names)
    except InputError:
        return {}


def _same(kept: np.ndarray | None, own: np.ndarray) -> bool:
    return kept is not None and kept.shape == own.shape and bool(np.abs(kept - own).max() <= SAME_GROOM)


def _read_note(path: Path) -> DrapeNote | None:
    try:
        return DrapeNote(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
