"""Elements of a file in Stanford's PLY: text, or binary of either byte order."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quaffure.errors import InputError, refused
from quaffure.io.binary import BinaryCursor

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 2**16  # bytes
MOST_VERTICES = 2**31


class _Property(NamedTuple):
    name: str
    dtype: str
    count_dtype: str = ""  # of a list's length; empty for one number


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


Table = dict[str, list[np.ndarray] | np.ndarray]
"""Values of an element by property; of a list property, an array for each row."""


def read_ply_tables(path: Path) -> dict[str, Table]:
    """The elements of a .ply file by name.

    Raises:
        InputError: not a .ply file, or cut short.
    """
    # What an integer or float32 cannot hold becomes what the checks of its users refuse.
    with np.errstate(over="ignore", invalid="ignore"):
        return _read_tables(BinaryCursor(path))


def vertices_of(tables: dict[str, Table], path: Path) -> np.ndarray:
    """Positions of the vertices [V,3], float64.

    Raises:
        InputError: none.
    """
    vertices = tables.get("vertex", {})
    if not {"x", "y", "z"} <= {*vertices}:
        raise InputError(path, "vertices with x, y and z", f"{', '.join(vertices) or 'none'}")
    return np.stack([np.asarray(vertices[axis], dtype=np.float64) for axis in "xyz"], axis=1)


def _read_tables(cursor: BinaryCursor) -> dict[str, Table]:
    form, elements = _read_header(cursor)
    tables: dict[str, Table] = {}
    words = iter(cursor.content[cursor.offset :].split()) if form == "ascii" else None
    for element in elements:
        _check_size(element, cursor, words is not None)
        what = f"{element.rows} rows of {element.name}"
        with refused(cursor.path, what, ValueError, OverflowError, StopIteration):
            if words is not None:
                tables[element.name] = _text_rows(element, words)
            else:
                tables[element.name] = _binary_rows(element, cursor, BYTE_ORDERS[form])
    return tables


def _read_header(cursor: BinaryCursor) -> tuple[str, list[_Element]]:
    path = cursor.path
    end = cursor.content.find(b"end_header", 0, LONGEST_HEADER)
    line_end = cursor.content.find(b"\n", end)
    if not cursor.content.startswith(b"ply") or end < 0 or line_end < 0:
        raise InputError(path, "a .ply file, with a header from 'ply' to 'end_header'", repr(cursor.content[:16]))
    cursor.offset = line_end + 1
    form, elements = "", list[_Element]()
    for line in cursor.content[:end].decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", name, _] if name in BYTE_ORDERS:
                form = name
            case ["element", name, count] if count.isdecimal() and len(count) < 12 and int(count) < MOST_VERTICES:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count_type, kind, name] if {count_type, kind} <= {*TYPES} and elements:
                elements[-1].properties.append(_Property(name, TYPES[kind], TYPES[count_type]))
            case ["property", kind, name] if kind in TYPES and elements:
                elements[-1].properties.append(_Property(name, TYPES[kind]))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise InputError(path, "a header of format, element and property lines", repr(line[:60]))
    if not form:
        raise InputError(path, f"a format ({', '.join(BYTE_ORDERS)})", "none")
    return form, elements


def _check_size(element: _Element, cursor: BinaryCursor, is_text: bool) -> None:
    """Refuse more rows than the file has bytes for."""
    least = sum(2 if is_text else np.dtype(p.count_dtype or p.dtype).itemsize for p in element.properties)
    left = len(cursor.content) - cursor.offset + (1 if is_text else 0)
    if element.rows * max(least, 1) > left:
        raise InputError(cursor.path, f"{element.rows} rows of {element.name}", f"{left} bytes left for them")


def _text_rows(element: _Element, words: Iterator[bytes]) -> Table:
    if not any(p.count_dtype for p in element.properties):
        width = len(element.properties)
        values = np.array([float(next(words)) for _ in range(element.rows * width)]).reshape(-1, max(width, 1))
        return {p.name: values[:, column].astype(p.dtype) for column, p in enumerate(element.properties)}
    table: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
    for _ in range(element.rows):
        for p in element.properties:
            count = int(next(words)) if p.count_dtype else 1
            table[p.name].append(np.array([float(next(words)) for _ in range(count)]).astype(p.dtype))
    return {**table}


def _binary_rows(element: _Element, cursor: BinaryCursor, order: str) -> Table:
    what = f"{element.rows} rows of {element.name}"
    if not any(p.count_dtype for p in element.properties):
        kind = np.dtype([(f"{column}", order + p.dtype) for column, p in enumerate(element.properties)])
        cursor.require(element.rows, kind.itemsize, what)
        rows = np.frombuffer(cursor.content, kind, element.rows, cursor.offset)
        cursor.offset += rows.nbytes
        return {p.name: rows[f"{column}"] for column, p in enumerate(element.properties)}
    table: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
    for _ in range(element.rows):
        for p in element.properties:
            count = int(cursor.array(order + p.count_dtype, 1, what)[0]) if p.count_dtype else 1
            if count < 0:
                raise ValueError(f"a list of {count}")
            table[p.name].append(cursor.array(order + p.dtype, count, what))
    return {**table}
