"""Files that appear whole or not at all."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quaffure.errors import refused
from quaffure.io.output_path import WRITABLE, check_place
from quaffure.io.temporary_file import sweep_temporary_files, temporary_in


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a path in the same folder, with the same suffix, that replaces `path` when the block ends well.

    Its bytes are on the disk before. When the block raises, the temporary file is removed and a file at `path` stays as
    it was. Where `path` is a symbolic link, the file that it leads to is replaced.

    Raises:
        InputError: the folder of `path` does not exist or is not writable, or the block raises an `OSError`, on a full
            disk for instance. Libraries that write by themselves and raise something else need a translation.
    """
    target = check_place(path)
    sweep_temporary_files(target.parent)
    temporary = temporary_in(target.parent, path.suffix)
    # The name is known before the file exists: an interrupt at any moment leads to the removal.
    try:
        with refused(path, WRITABLE, OSError):
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        with refused(path, "a file that can be written", OSError):
            yield temporary
            _synchronise(temporary, os.O_RDWR)
            temporary.replace(target)
        with suppress(OSError):  # not every system synchronises folders
            _synchronise(target.parent, os.O_RDONLY)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, value: object) -> None:
    """Write plain JSON.

    Raises:
        InputError: it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def _synchronise(path: Path, flags: int) -> None:
    """Wait until the disk has a file, or the names in a folder."""
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
