"""An object of a glTF document's JSON, each of whose fields is checked as it is read."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from quaffure.errors import InputError
from quaffure.io.character_limits import LARGEST_NUMBER
from quaffure.io.distinct_names import one_line

MOST = 2**31 - 1


@dataclass(frozen=True)
class Entry:
    """One object, and where it is.

    Attributes:
        path: the file.
        place: in its document, for messages: `accessors[3]`.
        fields: its content.
    """

    path: Path
    place: str
    fields: dict[str, Any]

    def fail(self, expected: str, found: str) -> NoReturn:
        """Refuse the file because of this object.

        Raises:
            InputError: always.
        """
        raise InputError(f"{self.path}, {self.place}" if self.place else self.path, expected, found)

    def __contains__(self, key: object) -> bool:
        return key in self.fields

    def integer(self, key: str, default: int | None = None, least: int = 0, most: int = MOST) -> int:
        """A whole number within limits; required where it has no default."""
        value = self.fields.get(key, default)
        if type(value) is float and value.is_integer():  # JSON's 3.0 is a whole number
            value = int(value)
        if type(value) is not int or not least <= value <= most:
            self.fail(f"{key} from {least} to {most}", _shown(value))
        return value

    def index(self, key: str, count: int) -> int:
        """An index of one of `count` objects."""
        if count < 1:
            self.fail(f"something for {key} to refer to", "none in the file")
        return self.integer(key, most=count - 1)

    def indices(self, key: str, count: int) -> list[int]:
        """A list of indices; empty where it is missing."""
        values = self.fields.get(key, [])
        if not isinstance(values, list) or not all(type(value) is int and 0 <= value < count for value in values):
            self.fail(f"{key}: indices below {count}", _shown(values))
        return values

    def numbers(self, key: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """As many real numbers as the default has; any number of them where that is empty."""
        values = self.fields.get(key, default)
        is_list = isinstance(values, list | tuple) and len(values) == (len(default) or len(values))
        if not is_list or not all(type(value) in (int, float) and abs(value) <= LARGEST_NUMBER for value in values):
            self.fail(f"{key}: {len(default) or 'any number of'} numbers within {LARGEST_NUMBER:g}", _shown(values))
        return tuple(map(float, values))

    def text(self, key: str, default: str = "") -> str:
        """A text in one line."""
        value = self.fields.get(key, default)
        if not isinstance(value, str):
            self.fail(f"a text as {key}", _shown(value))
        return one_line(value)

    def flag(self, key: str) -> bool:
        return self.fields.get(key) is True

    def entry(self, key: str) -> "Entry | None":
        """An object in this one; None where it is missing."""
        value = self.fields.get(key)
        if value is None:
            return None
        place = f"{self.place}.{key}" if self.place else key
        if not isinstance(value, dict):
            self.fail(f"an object as {key}", _shown(value))
        return Entry(self.path, place, value)

    def required(self, key: str) -> "Entry":
        entry = self.entry(key)
        return entry if entry is not None else self.fail(f"an object {key}", "none")

    def extension(self, name: str) -> "Entry | None":
        """What an extension adds to this object."""
        extensions = self.entry("extensions")
        return None if extensions is None else extensions.entry(name)

    def entries(self, key: str) -> "list[Entry]":
        """The objects of a list; empty where it is missing."""
        return list(self._entries(key))

    def _entries(self, key: str) -> "Iterator[Entry]":
        values = self.fields.get(key, [])
        if not isinstance(values, list):
            self.fail(f"a list of {key}", _shown(values))
        prefix = f"{self.place}." if self.place else ""
        for index, value in enumerate(values):
            if not isinstance(value, dict):
                self.fail(f"an object as {key}[{index}]", _shown(value))
            yield Entry(self.path, f"{prefix}{key}[{index}]", value)


def _shown(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    text = repr(value) if not isinstance(value, int) or abs(value) <= MOST else "a number beyond any count"
    return text if len(text) <= 40 else f"{text[:40]}..."
