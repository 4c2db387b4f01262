"""Files that appear whole or not at all."""

import json
import os
import sys
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
    with replacing_together(path) as (temporary,):
        yield temporary


@contextmanager
def replacing_together(path: Path, *others: Path) -> Iterator[list[Path]]:
    """`replacing` of files that belong together: none is replaced before the bytes of all are on the disk.

    Args:
        path: which errors of the block name.

    Raises:
        InputError: as `replacing`.
    """
    targets = {each: check_place(each) for each in (path, *others)}
    for folder in {target.parent for target in targets.values()}:
        sweep_temporary_files(folder)
    temporaries = {each: temporary_in(target.parent, each.suffix) for each, target in targets.items()}
    # The names are known before the files exist: an interrupt at any moment leads to the removal.
    try:
        for each, temporary in temporaries.items():
            with refused(each, WRITABLE, OSError):
                os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        with refused(path, "a file that can be written", OSError), _interrupts():
            yield [*temporaries.values()]
            for temporary in temporaries.values():
                _synchronise(temporary, os.O_RDWR)
            for each, temporary in temporaries.items():
                temporary.replace(targets[each])
        for folder in {target.parent for target in targets.values()}:
            with suppress(OSError):  # not every system synchronises folders
                _synchronise(folder, os.O_RDONLY)
    finally:
        for temporary in temporaries.values():
            temporary.unlink(missing_ok=True)


@contextmanager
def _interrupts() -> Iterator[None]:
    """Raise an interrupt as such where a library raises another error while it ends: zipfile cannot be closed then."""
    before = sys.exception()
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and cause is not before:
            if isinstance(cause, KeyboardInterrupt):
                raise cause from None
            cause = cause.__context__
        raise


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
