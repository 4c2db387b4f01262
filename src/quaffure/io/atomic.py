"""Files that appear whole or not at all."""

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from quaffure.errors import InputError, refused


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a path in the same folder, with the same suffix, that replaces `path` when the block ends well.

    When the block raises, the temporary file is removed and a file at `path` stays as it was.

    Raises:
        InputError: the folder of `path` does not exist or is not writable.
    """
    check_folder_of(path)
    with refused(path, "a writable folder", OSError):
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes the file private; give it the mode that open() would have given.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def check_folder_of(path: Path) -> None:
    """Refuse a file that could not be written later on, before any work is done for it.

    Raises:
        InputError: the folder of `path` does not exist, or `path` is a folder itself.
    """
    if not path.parent.is_dir():
        raise InputError(path, "a path in an existing folder", f"no folder {path.parent}")
    if path.is_dir():
        raise InputError(path, "a file to write", "a folder")


def check_output(path: Path, *suffixes: str) -> None:
    """Refuse an output file that could not be written, before the work for it.

    Raises:
        InputError: another suffix, no folder to write into, or a folder of that name.
    """
    if path.suffix.lower() not in suffixes:
        raise InputError(path, f"an output of suffix {', '.join(suffixes)}", f"suffix '{path.suffix}'")
    check_folder_of(path)


def made_folder(path: Path, what: str) -> Path:
    """The folder, made with its parents where it does not exist.

    Args:
        what: what it is, for the error: `a folder for drapes`.

    Raises:
        InputError: it cannot be made.
    """
    with refused(path, what, OSError):
        path.mkdir(parents=True, exist_ok=True)
    return path


def write_json(path: Path, value: object) -> None:
    """Write plain JSON.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
