"""The one error that a user's mistake raises."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MOST_TEXT = 2000
"""Characters of each part of a message."""


class InputError(ValueError):
    """Bad input: which source, what was expected there and what was found. Its text is one line, whatever a file holds.

    Args:
        source: the file, option or argument at fault.
        expected: what a good input would have held.
        found: what this one holds.
    """

    def __init__(self, source: str | Path, expected: str, found: str) -> None:
        # A text of a file may hold a line break, and megabytes.
        self.source, self.expected, self.found = (
            " ".join(str(part)[:MOST_TEXT].splitlines()) for part in (source, expected, found)
        )
        super().__init__(f"{self.source}: expected {self.expected}, found {self.found}")


@contextmanager
def refused(source: str | Path, expected: str, *kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of these kinds into an `InputError` that holds the first line of what they say."""
    try:
        yield
    except InputError:
        raise
    except kinds as error:
        raise InputError(source, expected, _found(error)) from error


def _found(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if isinstance(error, UnicodeDecodeError):
        return "bytes that are not text"
    said: str = getattr(error, "strerror", None) or str(error).strip() or type(error).__name__
    return said.splitlines()[0]
