"""What every reader checks before it opens a file."""

import re
import stat
import tomllib
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from quaffure.errors import InputError, refused

MOST_LINES, LONGEST_LINE = 2000, 200
"""Limits of TOML: Python's reader takes time and memory of the square of a dotted key's length, 3 s for 16 kB."""
PREVIEW = 512
"""Bytes of a file from which to say what it is."""
_NAMED_CLIP = re.compile(r"(.+\.(?:glb|gltf|fbx))#(.*)", re.IGNORECASE | re.DOTALL)


def check_input_file(path: Path, expected: str) -> None:
    """Refuse what is not a regular file: opening a FIFO waits for a writer, and a device has no end.

    Args:
        expected: what the file should be, for the error.

    Raises:
        InputError: no such file, or a folder, FIFO, socket or device.
    """
    with refused(path, expected, OSError, ValueError):  # ValueError: a NUL in the name
        mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise InputError(path, expected, "a folder")
    check_no_stream(path, expected)


def check_no_stream(path: Path, expected: str) -> None:
    """Refuse a name that a library may open, as `check_input_file` does; nothing or a folder of that name is not ours.

    Raises:
        InputError: a FIFO, socket or device.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(path, expected, "a pipe, socket or device")


def read_text(path: Path, expected: str, encoding: str = "utf-8", errors: str = "strict") -> str:
    """The text of a file.

    Args:
        expected: what the file should be, for the error.
        encoding, errors: as for `open`.

    Raises:
        InputError: it cannot be read, is not a regular file, or its bytes are not text.
    """
    check_input_file(path, expected)
    with refused(path, expected, OSError, UnicodeDecodeError):
        return path.read_text(encoding=encoding, errors=errors)


def read_toml(path: Path, expected: str) -> dict[str, Any]:
    """The tables of a file of settings.

    Args:
        expected: what the file should be, for the error.

    Raises:
        InputError: as `read_text`, no TOML, or larger than `MOST_LINES` and `LONGEST_LINE`.
    """
    lines = read_text(path, expected).split("\n")
    if len(lines) > MOST_LINES or max(map(len, lines)) > LONGEST_LINE:
        limits = f"{expected} of at most {MOST_LINES} lines and {LONGEST_LINE} characters a line"
        raise InputError(path, limits, f"{len(lines)} lines and {max(map(len, lines))} characters")
    # ValueError: TOML that is none, and numbers of thousands of digits, which Python neither reads nor writes.
    with refused(path, expected, ValueError, RecursionError):
        return tomllib.loads("\n".join(lines))


def did_you_mean(word: str | Path, names: Iterable[str]) -> str:
    """Text that ends a message about a word that is none of some names: the name that is most similar, if any is."""
    similar = get_close_matches(str(word), names, 1)
    return f"; did you mean {similar[0]}?" if similar else ""


def check_start(path: Path, starts: tuple[bytes, ...], expected: str) -> None:
    """Refuse a file that is of another format by its first bytes, before a library is given it.

    Args:
        starts: first bytes of the format's files.
        expected: as of `check_input_file`.

    Raises:
        InputError: it starts otherwise.
    """
    check_input_file(path, expected)
    with refused(path, expected, OSError), path.open("rb") as file:
        start = file.read(PREVIEW)
    if not start.startswith(starts):
        is_text = start and all(byte >= 32 or byte in b"\t\n\r" for byte in start)
        raise InputError(path, expected, "plain text" if is_text else "another format" if start else "an empty file")


def file_and_clip(source: str | Path) -> tuple[Path, str]:
    """The file in `FILE.glb#CLIP`, and the name of the clip; no name where there is none."""
    match = _NAMED_CLIP.fullmatch(str(source))
    return (Path(match[1]), match[2]) if match is not None and not Path(source).exists() else (Path(source), "")
