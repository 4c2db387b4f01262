"""Drapes on disk, so that a stopped evaluation continues and never drapes the same frame twice."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from quaffure.digest import array_digest
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.strands import held_parts_of
from quaffure.io.atomic import replacing
from quaffure.io.held_parts import HELD_PARTS_SPEC
from quaffure.io.output_path import made_folder
from quaffure.npz import REAL, TEXT, Spec, read_arrays
from quaffure.types import Float, Tensor

SAME_GROOM = 1e-5
"""Grooms are the same where no vertex [m] and no root [in the scalp's chart] differs by more."""
DRAPE: Spec = {"strands": (("S", "N", 3), (np.float32,)), "milliseconds": ((), REAL), "machine": ((), TEXT)}
"""Times below zero are unknown."""
GROOM: Spec = {"rest_strands": (("S", "N", 3), REAL), "root_uv": (("S", 2), REAL)}
HELD_PARTS_TOLERANCE = 1e-5
"""Held parts are the same where none differs by a larger share."""


@dataclass(frozen=True)
class TimedDrape:
    """One frame, draped.

    Attributes:
        strands: draped vertices [m, world].
        milliseconds: time of this drape, from pose in to strands out; None where it is unknown.
        machine: on which it was measured, and by which clock.
    """

    strands: Float[Tensor, "s n 3"]
    milliseconds: float | None
    machine: str = ""


class DrapeCache:
    """A folder of drapes by key (`drape_key`): `<key>.npz`; grooms in `grooms`.

    A process that is killed leaves nothing half-written. Processes may share a folder.

    Raises:
        InputError: the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = made_folder(folder, "a folder for drapes")

    def get(self, key: str) -> TimedDrape | None:
        """The drape of a key; None where there is none, or where its file is damaged."""
        arrays = _read_arrays(self.folder / f"{key}.npz", DRAPE)
        if not arrays:
            return None
        milliseconds = float(arrays["milliseconds"])
        taken = milliseconds if milliseconds >= 0 else None
        return TimedDrape(torch.from_numpy(arrays["strands"]), taken, str(arrays["machine"]))

    def put(self, key: str, drape: TimedDrape, case: str, frame: int, draper: str) -> None:
        """Keep a drape; case, frame of the clip and draper are written for readers of the file."""
        taken = -1.0 if drape.milliseconds is None else drape.milliseconds
        made = f"{case}, frame {frame}, {draper}"
        with replacing(self.folder / f"{key}.npz") as temporary:
            np.savez(temporary, strands=drape.strands.numpy(), milliseconds=taken, machine=drape.machine, made=made)

    def groom_key(self, groom: Groom) -> str:
        """Digest of the groom in this folder that is the same within `SAME_GROOM` and `HELD_PARTS_TOLERANCE`; where
        there is none, of this one, which the folder keeps.

        No groom is the same to the last bit on another processor or freshly compiled.
        """
        own = {name: getattr(groom, name).numpy() for name in GROOM}
        own |= {name: values.numpy() for name, values in held_parts_of(groom).items()}
        folder = made_folder(self.folder / "grooms", "a folder for grooms")
        for path in sorted(folder.glob("*.npz")):
            if _is_same(_read_arrays(path, GROOM, HELD_PARTS_SPEC), own):
                return path.stem
        key = array_digest(*own.values())
        with replacing(folder / f"{key}.npz") as temporary:
            np.savez(temporary, **own)
        return key


def _read_arrays(path: Path, spec: Spec, optional: Spec | None = None) -> dict[str, np.ndarray]:
    """Nothing of a file that is lost or damaged."""
    try:
        return read_arrays(path, spec, "a file of the cache", optional)[0]
    except InputError:
        return {}


def _is_same(kept: dict[str, np.ndarray], own: dict[str, np.ndarray]) -> bool:
    """Whether arrays of a file are those of a groom."""
    if kept.keys() != own.keys() or any(kept[name].shape != values.shape for name, values in own.items()):
        return False
    if any(np.abs(kept[name] - own[name]).max() > SAME_GROOM for name in GROOM):
        return False
    return all(np.allclose(kept[name], own[name], HELD_PARTS_TOLERANCE, 0.0) for name in own.keys() - GROOM.keys())
