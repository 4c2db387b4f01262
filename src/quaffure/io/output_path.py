"""What is checked of output files and folders before the work for them."""

import os
import stat
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from quaffure.errors import InputError, refused
from quaffure.input_file import file_and_clip
from quaffure.io.named_files import named_files
from quaffure.io.temporary_file import sweep_temporary_files

WRITABLE = "a writable folder"


def link_target(path: Path) -> Path:
    """The file that writing to `path` changes: where a symbolic link leads, though that may not exist."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def check_place(path: Path) -> Path:
    """Refuse a path that cannot be that of a new file.

    Returns:
        The file to write: the target of a symbolic link.

    Raises:
        InputError: the folder does not exist, or `path` is a folder, FIFO, socket or device.
    """
    with refused(path, "a path in an existing folder", OSError, ValueError):  # of a name too long, or with a NUL
        target = link_target(path)
        if not target.parent.is_dir():
            raise InputError(path, "a path in an existing folder", f"no folder {target.parent}")
        if target.exists() and not stat.S_ISREG(target.stat().st_mode):
            raise InputError(path, "a file to write", "a folder" if target.is_dir() else "a pipe, socket or device")
    return target


def check_output(path: Path, *suffixes: str, inputs: Iterable[str | Path | None] = ()) -> None:
    """Refuse an output file that could not be written, or that would replace what is read, before the work for it.

    Args:
        suffixes: in small letters, of which the file has to have one.
        inputs: files that the command reads, and names that may be files.

    Raises:
        InputError: another suffix, no folder to write into, a folder or a pipe of that name, or an input or a file that
            one names.
    """
    if path.suffix.lower() not in suffixes:
        # Not Path.is_dir, which raises for long names.
        found = "a folder" if os.path.isdir(path) else f"suffix '{path.suffix}'"
        raise InputError(path, f"an output of suffix {', '.join(suffixes)}", found)
    check_writable(check_place(path).parent, path)
    check_not_input(path, inputs)


def check_suffix(path: Path, *suffixes: str) -> None:
    """Refuse a name that a writer's format does not have.

    Args:
        suffixes: in small letters, of which the name has to have one.

    Raises:
        InputError: another suffix.
    """
    if path.suffix.lower() not in suffixes:
        raise InputError(path, f"a name ending in {', '.join(suffixes)}", f"{path.suffix or 'no suffix'}")


def check_one_frame(path: Path, frames: int) -> None:
    """Refuse a clip for a format of one frame.

    Raises:
        InputError: another number of frames.
    """
    if frames != 1:
        raise InputError(path, "a drape of one frame (--frames 30, --every)", f"{frames}")


def check_not_input(path: Path, inputs: Iterable[str | Path | None]) -> None:
    """Refuse an output that would replace an input, or a file that an input names.

    Raises:
        InputError: it is one of them, by whatever name.
    """
    check_no_inputs((path,), inputs)


def check_no_inputs(paths: Iterable[Path], inputs: Iterable[str | Path | None]) -> None:
    """`check_not_input` of several outputs, for which every input is opened once."""
    sources = [*dict.fromkeys(source for source in inputs if source is not None)]
    files = {_identity(file_and_clip(source)[0]): f"the input {source}" for source in reversed(sources)}
    replaced = [path for path in paths if _refuse_known(path, files).exists()]
    if not replaced:
        return
    for source in sources:
        for file in named_files(file_and_clip(source)[0]):
            files.setdefault(_identity(file), f"a file that the input {source} names")
    for path in replaced:
        _refuse_known(path, files)


def _refuse_known(path: Path, files: Mapping[object, str]) -> Path:
    found = files.get(_identity(path))
    if found is not None:
        raise InputError(path, "an output that is none of the inputs", found)
    return path


def check_distinct(paths: Iterable[Path]) -> None:
    """Refuse outputs of which a later one would replace an earlier one.

    Raises:
        InputError: two are the same file.
    """
    before: set[object] = set()
    for path in paths:
        file = _identity(path)
        if file in before:
            raise InputError(path, "outputs that differ", "the same file twice")
        before.add(file)


def check_writable(folder: Path, source: Path) -> None:
    """Refuse a folder into which no file can be written, by writing one; files that killed runs left there are removed.

    Args:
        source: what the error names.

    Raises:
        InputError: it is read-only, or its disk is full.
    """
    sweep_temporary_files(folder)
    with refused(source, WRITABLE, OSError):
        tempfile.TemporaryFile(dir=folder).close()


def made_folder(path: Path, what: str) -> Path:
    """The folder, made with its parents where it does not exist.

    Args:
        what: what it is, for the error: `a folder for drapes`.

    Raises:
        InputError: it cannot be made or written into.
    """
    with refused(path, what, OSError):
        path.mkdir(parents=True, exist_ok=True)
    check_writable(path, path)
    return path


def check_output_folder(path: Path, what: str, replaced: Iterable[str] = (), inputs: Iterable[Any] = ()) -> None:
    """Refuse a folder that could not be made or written into, before the work for it. Makes nothing.

    Args:
        what: as for `made_folder`.
        replaced: names of files in it that will be written.
        inputs: as for `check_output`.

    Raises:
        InputError: a file in its place, a folder that is read-only, or an input among the files.
    """
    with refused(path, what, OSError, ValueError):  # of a name too long, or with a NUL
        existing = next(folder for folder in (path.absolute(), *path.absolute().parents) if os.path.lexists(folder))
        if not existing.is_dir():
            raise InputError(path, what, f"a file {existing}")
    check_writable(existing, path)
    check_no_inputs([path / name for name in replaced], inputs)


def _identity(path: Path) -> object:
    """Equal for all names of a file, whether it exists or not."""
    try:
        found = path.stat()
    except (OSError, ValueError):  # it does not exist, or cannot
        return os.path.realpath(path)
    return found.st_dev, found.st_ino
