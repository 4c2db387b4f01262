"""Records of a binary FBX file, read as they are asked for; every size is checked before memory is taken.

Written from the notes of Blender's developers (code.blender.org, "FBX binary file format specification"). A record is
the place where it ends, the number and the size of its properties, its name, the properties, and records below it, of
which a record of zeros is the last. Up to version 7400 these numbers have 32 bits, from 7500 on 64.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from jaxtyping import Float, Int, Shaped

from quaffure.errors import InputError
from quaffure.input_file import check_input_file
from quaffure.io.binary import BinaryCursor
from quaffure.io.character_limits import FREE_BYTES, LARGEST_NUMBER, MOST_COMPRESSION
from quaffure.io.distinct_names import one_line

FBX_SUFFIX = ".fbx"
ADVICE = "Blender: File > Export > FBX; in other programs: FBX, binary"
EXPECTED = f"a binary FBX file of version 7.1 to 7.7 ({ADVICE})"
MAGIC = b"Kaydara FBX Binary  \0\x1a\0"
OLDEST, WIDE, NEWEST = 7100, 7500, 7700
"""Versions; `WIDE` is the first whose records have numbers of 64 bits."""
NEW_CLOCK, OLD_CLOCK = 0, 127
TICKS_PER_SECOND = {NEW_CLOCK: 141_120_000, OLD_CLOCK: 46_186_158_000}
"""By TCDefinition in the header. Files without it have the clock that all files before version 7700 have."""
BYTES_A_RECORD = 600
MOST_INFLATION = 1032
"""Bytes that zlib makes of one at most."""
SCALARS = {
    "Y": struct.Struct("<h"), "B": struct.Struct("<B"), "C": struct.Struct("<B"), "I": struct.Struct("<i"),
    "L": struct.Struct("<q"), "F": struct.Struct("<f"), "D": struct.Struct("<d"),
}  # fmt: skip
ARRAYS = {"f": "<f4", "d": "<f8", "i": "<i4", "l": "<i8", "b": "u1", "c": "u1"}
ARRAY_HEADER, LENGTH = struct.Struct("<III"), struct.Struct("<I")
RAW, DEFLATED = 0, 1
"""Encodings of an array."""


class PackedArray(NamedTuple):
    """An array of a file that is not decoded yet: type, length, encoding, and where its bytes begin and end."""

    dtype: "np.dtype[np.generic]"
    length: int
    encoding: int
    start: int
    end: int


Value = int | float | bytes | PackedArray


@dataclass(eq=False)
class FbxFile:
    """The bytes of a file.

    Attributes:
        path: the file.
        content: all of it.
        version: 7100 to 7700.
        free_bytes: memory that arrays may still use [bytes].
    """

    path: Path
    content: bytes
    version: int
    free_bytes: int = field(init=False)

    def __post_init__(self) -> None:
        self.free_bytes = max(FREE_BYTES, MOST_COMPRESSION * len(self.content))

    @property
    def header(self) -> struct.Struct:
        """The numbers that a record begins with: its end, and number and bytes of its properties."""
        return struct.Struct("<QQQ" if self.version >= WIDE else "<III")

    @cached_property
    def ticks_per_second(self) -> int:
        """Ticks of the clock that times of keys are in.

        Raises:
            InputError: the header names another clock.
        """
        header = self.section("FBXHeaderExtension")
        flags = header and header.child("OtherFlags")
        clock = flags and flags.child("TCDefinition")
        if clock is None:
            return TICKS_PER_SECOND[OLD_CLOCK]
        if clock.integer(0) not in TICKS_PER_SECOND:
            clock.fail(" or ".join(map(str, TICKS_PER_SECOND)), f"{clock.integer(0)}")
        return TICKS_PER_SECOND[clock.integer(0)]

    def section(self, name: str) -> "FbxRecord | None":
        """A record at the top of the file; None where it is missing."""
        return next((record for record in self._top if record.name == name), None)

    @cached_property
    def _top(self) -> "list[FbxRecord]":
        return list(_records(self, len(MAGIC) + 4, len(self.content)))


@dataclass(frozen=True, eq=False)
class FbxRecord:
    """One record.

    Attributes:
        file: that it is in.
        name: in one line.
        start, end: of the record [bytes].
        property_range: number of its properties, and where they begin and end [bytes].
    """

    file: FbxFile
    name: str
    start: int
    end: int
    property_range: tuple[int, int, int]

    def fail(self, expected: str, found: str) -> NoReturn:
        """Refuse the file because of this record.

        Raises:
            InputError: always.
        """
        raise InputError(f"{self.file.path}, {self.name[:40]} at byte {self.start}", expected, found)

    def reserve(self, count: int, is_kept: bool = True) -> None:
        """Account for bytes before memory is taken for them.

        Args:
            is_kept: or given back at once.

        Raises:
            InputError: more than a file of this size should hold.
        """
        left = self.file.free_bytes - count
        self.file.free_bytes = left if is_kept else self.file.free_bytes
        if left < 0:
            self.fail("arrays that fit in a file of its size", f"{count} more bytes")

    @cached_property
    def children(self) -> "list[FbxRecord]":
        return list(_records(self.file, self.property_range[2], self.end))

    def child(self, name: str) -> "FbxRecord | None":
        """The first record of a name below this one; None where it is missing."""
        return self._first.get(name)

    @cached_property
    def _first(self) -> "dict[str, FbxRecord]":
        return {record.name: record for record in reversed(self.children)}

    def required(self, name: str) -> "FbxRecord":
        """The first record of a name below this one.

        Raises:
            InputError: it is missing.
        """
        record = self.child(name)
        return record if record is not None else self.fail(f"a record {name}", "none")

    @cached_property
    def values(self) -> list[Value]:
        """The properties; arrays packed.

        Raises:
            InputError: properties that do not fit in the record, or of unknown types.
        """
        count, at, end = self.property_range
        if count > end - at:
            self.fail(f"at most {end - at} properties in its bytes", f"{count}")
        self.reserve(64 * count)
        found: list[Value] = []
        for _ in range(count):
            value, at = self._value(at, end)
            found.append(value)
        return found

    def integer(self, index: int) -> int:
        """A property that is a whole number.

        Raises:
            InputError: no such property, or another type.
        """
        value = self.values[index] if index < len(self.values) else None
        return value if isinstance(value, int) else self.fail(f"a whole number as property {index}", "another or none")

    def real(self, index: int) -> float:
        """A property that is a number.

        Raises:
            InputError: no such property, another type, or a number that is not finite or beyond `LARGEST_NUMBER`.
        """
        value = self.values[index] if index < len(self.values) else None
        if not isinstance(value, int | float) or not abs(value) <= LARGEST_NUMBER:
            self.fail(f"a number within {LARGEST_NUMBER:g} as property {index}", "another or none")
        return float(value)

    def text(self, index: int) -> str:
        """A property that is a text, in one line but for the zero between the name of an object and its class.

        Raises:
            InputError: no such property, or another type.
        """
        value = self.values[index] if index < len(self.values) else None
        if not isinstance(value, bytes):
            self.fail(f"a text as property {index}", "another or none")
        return "\0".join(one_line(part) for part in value.decode("utf-8", "replace").split("\0"))

    def floats(self, width: int) -> Float[np.ndarray, "n w"]:
        """The array that is the only property of this record, in rows.

        Raises:
            InputError: no array, of another width, or numbers that are not finite or beyond `LARGEST_NUMBER`.
        """
        values = self.numbers()
        if values.size % width:
            self.fail(f"rows of {width} numbers", f"{values.size} numbers")
        self.reserve(16 * values.size)
        return self.within(values.astype(np.float64).reshape(-1, width))

    def within(self, values: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Numbers of this record if they are finite and no larger than `LARGEST_NUMBER`.

        Raises:
            InputError: they are not.
        """
        if not (np.abs(values) <= LARGEST_NUMBER).all():
            self.fail(f"numbers within {LARGEST_NUMBER:g}", "others")
        return values

    def integers(self) -> Int[np.ndarray, " n"]:
        """The array of whole numbers that is the only property of this record.

        Raises:
            InputError: no such array.
        """
        values = self.numbers()
        if values.dtype.kind == "f":
            self.fail("whole numbers", "real ones")
        self.reserve(8 * values.size)
        return values.astype(np.int64)

    def numbers(self) -> Shaped[np.ndarray, " n"]:
        """The array that is the only property of this record, whatever its numbers are.

        Raises:
            InputError: no array, or a zlib stream that is damaged or of another size.
        """
        packed = self.values[0] if self.values else None
        if not isinstance(packed, PackedArray):
            self.fail("an array", "none")
        size = packed.length * packed.dtype.itemsize
        content = memoryview(self.file.content)[packed.start : packed.end]
        if packed.encoding == RAW:
            return np.frombuffer(content, packed.dtype, packed.length)
        if size > MOST_INFLATION * len(content):
            self.fail(f"at most {MOST_INFLATION * len(content)} bytes of {len(content)} compressed ones", f"{size}")
        self.reserve(2 * size)
        decoder = zlib.decompressobj()
        try:
            inflated = decoder.decompress(content, size + 1)
        except zlib.error as error:
            self.fail("a zlib stream", one_line(str(error)))
        if len(inflated) != size or not decoder.eof:
            self.fail(f"{size} bytes in its zlib stream", "more" if len(inflated) > size else f"{len(inflated)}")
        return np.frombuffer(inflated, packed.dtype, packed.length)

    def _value(self, at: int, end: int) -> tuple[Value, int]:
        """The property that begins at a byte, and where it ends."""
        kind = chr(self.file.content[at]) if at < end else ""
        at += 1
        if kind in SCALARS:
            (value,), end_of_value = self._unpacked(SCALARS[kind], at, end)
            return value, end_of_value
        if kind in ("S", "R"):
            (length,), at = self._unpacked(LENGTH, at, end)
            return self.file.content[at : self._checked(at + length, end)], at + length
        if kind not in ARRAYS:
            self.fail("properties of known types", f"{kind!r}")
        dtype = np.dtype(ARRAYS[kind])
        (count, encoding, length), at = self._unpacked(ARRAY_HEADER, at, end)
        if encoding not in (RAW, DEFLATED):
            self.fail("an array that is raw or a zlib stream", f"encoding {encoding}")
        length = count * dtype.itemsize if encoding == RAW else length
        return PackedArray(dtype, count, encoding, at, self._checked(at + length, end)), at + length

    def _unpacked(self, form: struct.Struct, at: int, end: int) -> tuple[tuple[Any, ...], int]:
        return form.unpack_from(self.file.content, self._checked(at + form.size, end) - form.size), at + form.size

    def _checked(self, needed: int, end: int) -> int:
        if needed > end:
            self.fail(
                f"properties of at least {needed - self.property_range[1]} bytes", f"{end - self.property_range[1]}"
            )
        return needed


def open_fbx(path: Path) -> FbxFile:
    """A binary FBX file.

    Raises:
        InputError: no such file, an FBX of text, of another version, or no FBX.
    """
    check_input_file(path, EXPECTED)
    cursor = BinaryCursor(path)
    if not cursor.content.startswith(MAGIC):
        is_text = b"FBX" in cursor.content[:64] and b"\0" not in cursor.content[:64]
        raise InputError(path, EXPECTED, "an FBX of text" if is_text else "another file")
    cursor.offset = len(MAGIC)
    (version,) = cursor.integers("<u4", 1, "version")
    if not OLDEST <= version <= NEWEST:
        raise InputError(path, EXPECTED, f"version {version / 1000:g}")
    return FbxFile(path, cursor.content, version)


def _records(file: FbxFile, start: int, end: int) -> Iterator[FbxRecord]:
    """Records from one byte to another, which is that after the record of zeros, if there is one."""
    header, at = file.header, start
    while at < end:
        place = f"{file.path}, record at byte {at}"
        after = at + header.size + 1
        if after > end:
            raise InputError(place, f"{after - at} bytes", f"{end - at}")
        last, count, size = header.unpack_from(file.content, at)
        if last == 0:
            return  # zeros; after those at the top is a footer, which says nothing
        name_end = after + file.content[after - 1]
        if not name_end + size <= last <= end:
            raise InputError(place, f"an end from byte {name_end + size} to {end}", f"{last}")
        name = one_line(file.content[after:name_end].decode("utf-8", "replace"))
        record = FbxRecord(file, name, at, last, (count, name_end, name_end + size))
        record.reserve(BYTES_A_RECORD)
        yield record
        at = last
