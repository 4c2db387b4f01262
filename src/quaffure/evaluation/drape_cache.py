"""Drapes on disk, so that an evaluation goes on where it was stopped and never drapes the same frame twice."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from quaffure.errors import InputError
from quaffure.io.atomic import replacing
from quaffure.io.npz_strands import read_npz
from quaffure.types import Float, Tensor

MANIFEST = "manifest.json"


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
class DrapeEntry:
    """What the manifest says of a drape.

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
    """A folder of drapes by fingerprint, with a manifest that says what each one is.

    A drape counts once the manifest has it: a process that dies in between leaves nothing half-written.

    Raises:
        InputError: the folder cannot be made, or its manifest is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, "a folder for drapes", error.strerror or str(error)) from error
        self._entries = _read_manifest(folder / MANIFEST)

    def __len__(self) -> int:
        """Number of drapes."""
        return len(self._entries)

    def get(self, key: str) -> TimedDrape | None:
        """The drape of a fingerprint; None where there is none, or where its file is lost or damaged."""
        entry = self._entries.get(key)
        if entry is None:
            return None
        try:
            strands = read_npz(self._path(key), ("strands",)).get("strands")
        except InputError:
            return None
        if strands is None or strands.dtype != np.float32:
            return None
        return TimedDrape(torch.from_numpy(strands), entry.milliseconds, entry.machine)

    def put(self, key: str, drape: TimedDrape, case: str, frame: int, draper: str) -> None:
        with replacing(self._path(key)) as temporary, temporary.open("wb") as file:
            np.savez(file, strands=drape.strands.numpy())
        self._entries[key] = DrapeEntry(case, frame, draper, drape.milliseconds, drape.machine)
        with replacing(self.folder / MANIFEST) as temporary:
            entries = {name: asdict(entry) for name, entry in self._entries.items()}
            temporary.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")

    def _path(self, key: str) -> Path:
        return self.folder / f"{key[:32]}.npz"


def _read_manifest(path: Path) -> dict[str, DrapeEntry]:
    if not path.is_file():
        return {}
    try:
        return {key: DrapeEntry(**entry) for key, entry in json.loads(path.read_text(encoding="utf-8")).items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(path, "a manifest of drapes, or none", str(error)) from error
