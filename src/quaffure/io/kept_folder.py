"""The folder of a drape's frames as others find it: its name, its lock, and whether it can be continued."""

import json
import os
import re
from pathlib import Path
from typing import Any

from quaffure.errors import InputError, refused
from quaffure.frame_store import Frames
from quaffure.input_file import read_text

SETTINGS, MILLISECONDS = "settings.json", "milliseconds.f32"
KEPT = "frames of an interrupted drape (remove the folder to start anew)"
WRITABLE = "a folder for frames that can be written"
PATTERN = ".*.frames"
MOST = 2**31
OWN_NAMES = "*.f32, settings.json, state-*.npy"
_OURS = re.compile(rf"({'|'.join(Frames._fields)}|milliseconds)\.f32|settings\.json|state-\d+\.npy|\.quaffure-.*")


def frames_path(output: Path) -> Path:
    """The folder for the frames of an output."""
    return output.with_name(f".{output.name}.frames")


def locked(path: Path) -> int | None:
    """Make a folder and lock it; the descriptor that holds the lock, where the system has such locks.

    Raises:
        InputError: another process holds it, it cannot be made, or it is a link or holds what no run leaves.
    """
    with refused(path, WRITABLE, OSError):
        while True:
            path.mkdir(exist_ok=True)
            _check_ours(path)
            try:
                import fcntl
            except ImportError:
                return None
            descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if path.exists() and os.path.samestat(path.stat(), os.fstat(descriptor)):
                    return descriptor
            except BlockingIOError as error:
                os.close(descriptor)
                raise InputError(path, "an output that no other run is making", "one that is being made") from error
            os.close(descriptor)  # of a folder that a sweep removed after it was opened


def _check_ours(path: Path) -> None:
    """Refuse a folder whose files are not all of a run: they are removed in the end."""
    expected = f"no folder of this name, or one of frames alone ({OWN_NAMES})"
    if path.is_symlink():
        raise InputError(path, expected, "a link")
    for file in path.iterdir():
        if not _OURS.fullmatch(file.name) or file.is_dir():
            raise InputError(path, expected, file.name)


def remove_files(path: Path) -> None:
    """Remove what runs leave in a folder."""
    for file in path.iterdir():
        if _OURS.fullmatch(file.name):
            file.unlink()


def holds_batch(path: Path) -> bool:
    """Whether a folder has a whole batch: its time is written last."""
    file = path / MILLISECONDS
    return file.is_file() and file.stat().st_size >= 4


def read_settings(path: Path) -> tuple[dict[str, Any], dict[str, list[int]]]:
    """Settings of the run that made a folder, and shapes of a frame's arrays.

    Raises:
        InputError: they are damaged.
    """
    with refused(path, KEPT, OSError, ValueError, RecursionError):
        found = json.loads(read_text(path / SETTINGS, KEPT))
        fields = found if isinstance(found, dict) else {}
        settings, shapes = fields.get("settings"), fields.get("shapes")
        if not isinstance(settings, dict) or not isinstance(shapes, dict) or {*shapes} != {*Frames._fields}:
            raise ValueError(f"other content of {SETTINGS}")
        for shape in shapes.values():
            is_whole = isinstance(shape, list) and all(type(size) is int and 0 < size < MOST for size in shape)
            if not is_whole or not 2 <= len(shape) <= 3:
                raise ValueError(f"a frame of shape {shape!r:.60}")
    return settings, shapes


def remove_abandoned(path: Path) -> None:
    """Remove the folder of a run that was killed before its first batch was whole, which nothing can continue.

    One that another process has locked stays, and so does what no run of this package leaves.
    """
    try:
        import fcntl
    except ImportError:  # no telling whether its run lives
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        files = [*path.iterdir()]
        if holds_batch(path) or not all(_OURS.fullmatch(file.name) for file in files):
            return
        if (path / SETTINGS).exists():
            read_settings(path)
        remove_files(path)
        path.rmdir()
    except (OSError, InputError):
        pass  # locked, not ours to remove, or damaged, which a user should hear of
    finally:
        os.close(descriptor)
