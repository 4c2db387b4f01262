"""Frames of a drape in a folder beside its output: memory does not grow, and an interrupted run continues."""

import json
import math
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from quaffure.errors import InputError, refused
from quaffure.frame_store import BatchState, Frames
from quaffure.io.atomic import write_json

SETTINGS = "settings.json"
WRITABLE = "a folder for frames that can be written"
FORMAT_VERSION = 2


def frames_path(output: Path) -> Path:
    """The folder for the frames of an output."""
    return output.with_name(f".{output.name}.frames")


def _locked(path: Path) -> int | None:
    """Make a folder and lock it; the descriptor that holds the lock, where the system has such locks.

    Raises:
        InputError: another process holds it, or it cannot be made.
    """
    with refused(path, WRITABLE, OSError):
        path.mkdir(exist_ok=True)
        try:
            import fcntl
        except ImportError:
            return None
        descriptor = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise InputError(path, "an output that no other run is making", "one that is being made") from error
        return descriptor


class FrameFolder:
    """Keeps frames in files to which batches are appended. Only whole batches count: what a killed run left of one is
    cut off.

    Args:
        path: the folder; made where there is none, and locked until it is closed or discarded.
        settings: of the run; a folder of other settings is not continued. Anything that JSON holds.
        batch: frames of a batch; only the last one may be shorter.
        resume: continue what is in the folder; otherwise the first batch replaces it.

    Raises:
        InputError: another run uses the folder, or to continue, but it holds frames of other settings, or is damaged.
    """

    def __init__(self, path: Path, settings: dict[str, Any], batch: int, resume: bool) -> None:
        self.path, self._settings, self._batch = path, {"format_version": FORMAT_VERSION, **settings}, batch
        self._shapes: dict[str, list[int]] = {}
        self._count = 0
        self.milliseconds: list[float] = []
        self._lock = _locked(path)
        self.holds_frames = (path / SETTINGS).exists()
        """Whether there are frames, of an earlier run or of this one."""
        if resume and self.holds_frames:
            try:
                with refused(
                    path, "frames of an interrupted drape (remove the folder to start anew)", OSError, ValueError
                ):
                    self._continue()
            except InputError:
                self.close()
                raise

    def __len__(self) -> int:
        return self._count

    @property
    def follows(self) -> Float32[np.ndarray, "s k"] | None:
        """What the frame after the last batch follows from, where frames follow each other."""
        path = self._state_path(self._count)
        return np.load(path, allow_pickle=False) if path.exists() else None

    def append(self, frames: Frames, state: BatchState) -> None:
        """Keep the next batch.

        Raises:
            InputError: the disk is full, or the folder is gone.
        """
        with refused(self.path, WRITABLE, OSError):
            if not self._count:
                self._start(frames)
            count = self._count + len(frames.strands)
            if state.follows is not None:
                np.save(self._state_path(count), state.follows)
            # The number of whole frames is that in the smallest file, so the batch counts once all of them are there.
            for name, array in frames._asdict().items():
                self._extend(name, np.ascontiguousarray(array, dtype="<f4"))
            self._extend("milliseconds", np.array([state.milliseconds], dtype="<f4"))
            self._state_path(self._count).unlink(missing_ok=True)
        self._count = count
        self.milliseconds.append(state.milliseconds)

    def frames(self) -> Frames:
        """All frames, read from the files as they are used."""
        arrays = (
            np.memmap(self._file(name), "<f4", "r", shape=(self._count, *self._shapes[name])) for name in Frames._fields
        )
        return Frames(*arrays)

    def discard(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.close()

    def close(self) -> None:
        """Leave the folder to other runs."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _start(self, frames: Frames) -> None:
        for file in self.path.iterdir():
            file.unlink()
        self.holds_frames = True
        self._shapes = {name: list(array.shape[1:]) for name, array in frames._asdict().items()}
        write_json(self.path / SETTINGS, {"settings": self._settings, "shapes": self._shapes})

    def _continue(self) -> None:
        """Raises:
        InputError: other settings.
        """
        found = json.loads((self.path / SETTINGS).read_text(encoding="utf-8"))
        before, now = found["settings"], json.loads(json.dumps(self._settings))
        if before != now:
            other = ", ".join(sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key)))
            raise InputError("--resume", f"the settings of the interrupted run in {self.path}", f"other {other}")
        self._shapes = {name: list(map(int, found["shapes"][name])) for name in Frames._fields}
        whole = min(self._file(name).stat().st_size // self._frame_bytes(name) for name in Frames._fields)
        batches = self._file("milliseconds").stat().st_size // 4
        total = int(self._settings["frames"])
        self._count = min(batches * self._batch, total if whole >= total else whole // self._batch * self._batch)
        for name in Frames._fields:
            os.truncate(self._file(name), self._count * self._frame_bytes(name))
        batches = math.ceil(self._count / self._batch)
        os.truncate(self._file("milliseconds"), 4 * batches)
        self.milliseconds = np.fromfile(self._file("milliseconds"), "<f4").tolist()

    def _frame_bytes(self, name: str) -> int:
        return 4 * math.prod(self._shapes[name])

    def _extend(self, name: str, array: np.ndarray) -> None:
        with self._file(name).open("ab") as file:
            file.write(array.data)

    def _file(self, name: str) -> Path:
        return self.path / f"{name}.f32"

    def _state_path(self, count: int) -> Path:
        return self.path / f"state-{count}.npy"
