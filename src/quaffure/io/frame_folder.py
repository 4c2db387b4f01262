"""Frames of a drape in a folder beside its output: memory does not grow, and an interrupted run continues."""

import json
import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from quaffure.errors import InputError, refused
from quaffure.frame_store import BatchState, Frames
from quaffure.io.atomic import write_json
from quaffure.io.kept_folder import KEPT, SETTINGS, WRITABLE, holds_batch, locked, read_settings, remove_files

FORMAT_VERSION = 2


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
        self._lock = locked(path)
        self.holds_frames = holds_batch(path)
        """Whether there is a whole batch, of an earlier run or of this one."""
        if resume and (self.holds_frames or (path / SETTINGS).exists()):
            try:
                self._continue()
            except InputError:
                self.close()
                raise

    def __len__(self) -> int:
        return self._count

    @property
    def draper_state(self) -> Float32[np.ndarray, "s k"] | None:
        """What the frame after the last batch follows from, where frames follow each other."""
        path = self._state_path(self._count)
        if not path.exists():
            return None
        with refused(self.path, KEPT, Exception):  # numpy's header parser raises many types on damaged bytes
            # Mapped, so that no memory is taken for what the file does not hold.
            state = np.load(path, mmap_mode="r", allow_pickle=False)
            if state.dtype != np.float32 or state.shape[:1] != (self._shapes["strands"][0],) or state.ndim != 2:
                raise ValueError(f"{path.name} of {state.dtype} {list(state.shape)}")
            if not np.isfinite(state).all():
                raise ValueError(f"NaN or infinity in {path.name}")
            return np.array(state)

    def append(self, frames: Frames, state: BatchState) -> None:
        """Keep the next batch.

        Raises:
            InputError: the disk is full, or the folder is gone.
        """
        with refused(self.path, WRITABLE, OSError):
            if not self._count:
                self._start(frames)
            count = self._count + len(frames.strands)
            if state.draper_state is not None:
                np.save(self._state_path(count), state.draper_state)
            # The number of whole frames is that in the smallest file, so the batch counts once all of them are there.
            for name, array in frames._asdict().items():
                self._extend(name, np.ascontiguousarray(array, dtype="<f4"))
            self._extend("milliseconds", np.array([state.milliseconds], dtype="<f4"))
            self._state_path(self._count).unlink(missing_ok=True)
        self._count, self.holds_frames = count, True
        self.milliseconds.append(state.milliseconds)

    def frames(self) -> Frames:
        """All frames, read from the files as they are used."""
        arrays = (
            np.memmap(self._file(name), "<f4", "r", shape=(self._count, *self._shapes[name])) for name in Frames._fields
        )
        return Frames(*arrays)

    def discard(self) -> None:
        """Remove the files, and the folder if it is empty then."""
        with suppress(OSError):
            remove_files(self.path)
            self.path.rmdir()
        self.close()

    def close(self) -> None:
        """Leave the folder to other runs."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _start(self, frames: Frames) -> None:
        self.holds_frames = False
        remove_files(self.path)
        self._shapes = {name: list(array.shape[1:]) for name, array in frames._asdict().items()}
        write_json(self.path / SETTINGS, {"settings": self._settings, "shapes": self._shapes})

    def _continue(self) -> None:
        """Raises:
        InputError: damaged files, or other settings.
        """
        before, shapes = read_settings(self.path)
        if not self.holds_frames:
            return
        now = json.loads(json.dumps(self._settings))
        if before != now:
            other = ", ".join(sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key)))
            raise InputError("--resume", f"the settings of the interrupted run in {self.path}", f"other {other}")
        self._shapes = shapes
        with refused(self.path, KEPT, OSError, ValueError):
            self._cut_off()

    def _cut_off(self) -> None:
        """Find the whole batches, and remove what comes after them."""
        whole = min(self._file(name).stat().st_size // self._frame_bytes(name) for name in Frames._fields)
        batches = self._file("milliseconds").stat().st_size // 4
        total = int(self._settings["frames"])
        count = min(batches * self._batch, total if whole >= total else whole // self._batch * self._batch)
        if not count:
            raise ValueError("fewer bytes than those of a batch")
        for name in Frames._fields:
            os.truncate(self._file(name), count * self._frame_bytes(name))
        os.truncate(self._file("milliseconds"), 4 * math.ceil(count / self._batch))
        self.milliseconds = np.fromfile(self._file("milliseconds"), "<f4").tolist()
        if not all(0 <= time < math.inf for time in self.milliseconds):
            raise ValueError("times that are none")
        self._count = count
        for name, array in self.frames()._asdict().items():
            if not all(np.isfinite(frame).all() for frame in array):
                raise ValueError(f"NaN or infinity in {name}")
        _ = self.draper_state  # damage of which is found now

    def _frame_bytes(self, name: str) -> int:
        return 4 * math.prod(self._shapes[name])

    def _extend(self, name: str, array: np.ndarray) -> None:
        with self._file(name).open("ab") as file:
            file.write(array.data)

    def _file(self, name: str) -> Path:
        return self.path / f"{name}.f32"

    def _state_path(self, count: int) -> Path:
        return self.path / f"state-{count}.npy"
