"""Arrays of an `.npz` file, each checked by its header before memory is taken for it. Nothing is ever unpickled."""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np

from quaffure.errors import InputError, refused
from quaffure.input_file import check_input_file

NumberType = type[np.generic]
Spec = Mapping[str, tuple[tuple[int | str, ...], tuple[NumberType, ...]]]
"""Each array's axes (a number is a fixed size; a letter is the same size in all arrays) and types, `numpy.floating` for
instance. Arrays of real numbers must be finite."""
REAL: tuple[NumberType, ...] = (np.floating,)
INTEGER: tuple[NumberType, ...] = (np.integer,)
NUMBER: tuple[NumberType, ...] = (np.floating, np.integer)
TEXT: tuple[NumberType, ...] = (np.str_,)
FREE_BYTES = 2**24
"""What the arrays of any file may take [bytes]; beyond it at most `MOST_COMPRESSION` times the size of the file."""
MOST_COMPRESSION = 32
"""Arrays of hair and motion shrink by less than 4, but zeros by 1000: a small file must not fill the memory."""
SURROGATES, CODES = range(0xD800, 0xE000), 0x110000
"""Codes of no characters, and how many there are."""
SHOWN_NAMES = 5
"""Names of arrays by which an error says what a file holds instead."""
PART_SIZE = 2**20
"""Numbers that are checked at once."""
IS_ENCRYPTED = 0x1
"""Bit of a member's flags."""


class Header(NamedTuple):
    """What a member of the archive says of its array."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def array_names(path: Path) -> frozenset[str]:
    """Names of the arrays in a file; none where it is no readable `.npz`."""
    try:
        with _opened(path, "an .npz file") as archive:
            return frozenset(name.removesuffix(".npy") for name in archive.namelist())
    except InputError:
        return frozenset()


def array_headers(path: Path) -> dict[str, Header]:
    """Shape and type of every array in a file, of pickled objects too; none of them is loaded.

    Raises:
        InputError: the file is missing, no `.npz` or damaged.
    """
    with _opened(path, "an undamaged .npz file") as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        _check_compression(archive, names, path)
        return {name: _header(archive, name, path) for name in names}


def is_number(header: Header) -> bool:
    """Whether an array holds plain numbers that `read_numbers` reads."""
    return _is_any(header.dtype, NUMBER)


def read_numbers(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Those of the named arrays that an `.npz` file has, of any shape.

    Raises:
        InputError: the file is missing, no `.npz` or damaged, or an array does not hold plain numbers.
    """
    with _opened(path, "an undamaged .npz file") as archive:
        present = [name for name in names if f"{name}.npy" in archive.namelist()]
        _check_members(archive, present, path)
        headers = {name: _header(archive, name, path) for name in present}
        for name, header in headers.items():
            if not _is_any(header.dtype, NUMBER):
                raise InputError(
                    path, f"plain numbers in its array {name}", f"{header.dtype} (pickled objects are never loaded)"
                )
        return {name: _array(archive, name) for name in present}


def read_arrays(
    path: Path, spec: Spec, what: str, optional: Spec | None = None
) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """All arrays of a specification, and the sizes of its lettered axes.

    Args:
        what: the kind of file, for errors: `a body file (.npz)`.
        optional: arrays that a file may lack.

    Raises:
        InputError: the file is missing, no `.npz` or damaged, lacks an array, or breaks the specification.
    """
    with _opened(path, what) as archive:
        missing = [name for name in spec if f"{name}.npy" not in archive.namelist()]
        if missing and len(missing) == len(spec):
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            raise InputError(path, what, f"another .npz, with the arrays {', '.join(names[:SHOWN_NAMES])}")
        if missing:
            raise InputError(path, f"{what} with the arrays {', '.join(spec)}", f"no array {', '.join(missing)}")
        found = {name: kind for name, kind in (optional or {}).items() if f"{name}.npy" in archive.namelist()}
        spec = {**spec, **found}
        _check_members(archive, spec, path)
        sizes = _check_headers({name: _header(archive, name, path) for name in spec}, spec, path, what)
        arrays = {name: _array(archive, name) for name in spec}
    _check_values(arrays, path, what)
    return arrays, sizes


def check_arrays(arrays: Mapping[str, np.ndarray], spec: Spec, source: Path, what: str) -> dict[str, int]:
    """Hold arrays to a specification before they are written; the sizes of its lettered axes.

    Raises:
        InputError: they break it.
    """
    headers = {name: Header(array.shape, array.dtype) for name, array in arrays.items()}
    sizes = _check_headers(headers, spec, source, what)
    _check_values(arrays, source, what)
    return sizes


@contextmanager
def _opened(path: Path, what: str) -> Iterator[ZipFile]:
    # On damaged bytes zipfile, zlib and numpy's header parser raise some ten unrelated types between them.
    check_input_file(path, what)
    with refused(path, what, Exception), ZipFile(path) as archive:
        yield archive


def _check_members(archive: ZipFile, names: Iterable[str], path: Path) -> None:
    """Refuse members that numpy does not write, and more bytes than a file of this size should hold."""
    members = _check_compression(archive, names, path)
    total = sum(member.file_size for member in members)
    most = max(FREE_BYTES, MOST_COMPRESSION * path.stat().st_size)
    if total > most:
        raise InputError(path, f"arrays of at most {most} bytes in a file of its size", f"{total} bytes")


def _check_compression(archive: ZipFile, names: Iterable[str], path: Path) -> list[ZipInfo]:
    """The members, which are as numpy writes them."""
    members = [archive.getinfo(f"{name}.npy") for name in names]
    for member in members:
        if member.flag_bits & IS_ENCRYPTED or member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            found = f"{member.filename} encrypted or compressed in another way"
            raise InputError(path, "arrays as numpy.savez writes them", found)
    return members


def _header(archive: ZipFile, name: str, path: Path) -> Header:
    member = archive.getinfo(f"{name}.npy")
    with archive.open(member) as file:
        # Version 3 exists only for field names beyond Latin-1, and plain numbers have no fields.
        is_first = np.lib.format.read_magic(file) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
        header = Header(shape, dtype)
        expected = file.tell() + math.prod(header.shape) * header.dtype.itemsize
    # The size of pickled objects is not in the header; they are refused by their type.
    if not header.dtype.hasobject and expected != member.file_size:
        found = f"{member.file_size} bytes"
        raise InputError(path, f"{expected} bytes to hold its array {name} {list(header.shape)}", found)
    return header


def _array(archive: ZipFile, name: str) -> np.ndarray:
    """An array in the byte order of this machine, which is the only one that torch takes."""
    with archive.open(f"{name}.npy") as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _check_headers(headers: Mapping[str, Header], spec: Spec, source: Path, what: str) -> dict[str, int]:
    sizes: dict[int | str, int] = {}
    for name, (axes, types) in spec.items():
        shape, dtype = headers[name]
        if not _is_any(dtype, types):
            allowed = " or ".join(kind.__name__.rstrip("_") for kind in types)
            raise InputError(source, f"{what} with {name} of type {allowed}", f"{dtype}")
        if len(shape) == len(axes):
            sizes = dict(zip(axes, shape)) | sizes
        expected = tuple(sizes.get(axis, axis) if isinstance(axis, str) else axis for axis in axes)
        if shape != expected:
            raise InputError(source, f"{what} with {name} of shape {expected}", f"{shape}")
    return {axis: size for axis, size in sizes.items() if isinstance(axis, str)}


def _check_values(arrays: Mapping[str, np.ndarray], source: Path, what: str) -> None:
    for name, array in arrays.items():
        if not _is_text(array):
            raise InputError(source, f"{what} with text as {name}", "codes of no characters")
        # As float32, in which arrays are used: 1e300 is infinite there.
        with np.errstate(over="ignore", invalid="ignore"):
            is_finite = array.dtype.kind != "f" or all(
                np.isfinite(part.astype(np.float32, copy=False)).all() for part in parts_of(array)
            )
        if not is_finite:
            raise InputError(source, f"{what} with finite {name}", "NaN or infinity")


def _is_text(array: np.ndarray) -> bool:
    """Whether Python has all characters of an array, if it is one of texts; damaged ones end `str` with an error of
    the interpreter."""
    if array.dtype.kind != "U" or not array.dtype.itemsize:
        return True
    codes = np.ascontiguousarray(array).reshape(-1).view(np.uint32)
    return bool(((codes < SURROGATES.start) | ((codes >= SURROGATES.stop) & (codes < CODES))).all())


def parts_of(array: np.ndarray) -> Iterator[np.ndarray]:
    """Consecutive rows of an array in parts of a few megabytes: it may be a file larger than the memory."""
    if not array.ndim:
        yield array
        return
    rows = max(1, PART_SIZE // max(1, math.prod(array.shape[1:])))
    yield from (array[first : first + rows] for first in range(0, len(array), rows))


def _is_any(dtype: np.dtype[Any], types: tuple[NumberType, ...]) -> bool:
    # numpy counts time differences as integers, and torch has no real numbers of more than 8 bytes.
    torch_has = dtype.kind in "biuU" or (dtype.kind == "f" and dtype.itemsize <= 8)
    return torch_has and any(np.issubdtype(dtype, kind) for kind in types)
