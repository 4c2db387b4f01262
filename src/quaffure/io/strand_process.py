"""Strands of a file that a library of another language reads, in a process of its own.

Such libraries end the process, or fill its memory, on damaged files of a few kilobytes. The process is a module of this
package: `serve` writes what it has read to the standard output, and `output_of_process` starts it and takes that.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.strand_attributes import StrandAttributes
from quaffure.hair.strands import Strands, held_parts_of
from quaffure.input_file import check_input_file
from quaffure.io.library_process import library_environment

# A text file takes some 6 times its size, and 0.2 s for a megabyte.
FREE_BYTES, BYTES_PER_BYTE = 2 << 30, 32
"""Limit of the process's memory: of any file [bytes], and for each byte of the file."""
FREE_SECONDS, SECONDS_PER_BYTE = 3.0, 2e-6
"""Limit of its processor time: of any file [s], and for each byte of the file [s]."""
WALL_TIME = 5.0
"""Limit of the wall time, in limits of the processor time: a reference may name a FIFO, and machines may be busy."""
LIBRARIES = {"usd": "USD", "alembic": "Alembic"}
"""Names of libraries by the extra that brings them."""
ATTRIBUTE = "attribute_"
"""Prefix of attributes of the strands."""
REFUSED = 3
"""Exit code of the process with an error of the file's."""
Value = TypeVar("Value")


def read_in_process(module: str, path: Path, extra: str, expected: str) -> Strands:
    """Strands that a module reads from a file, and writes with `write_strands`.

    Args:
        module, extra, expected: as of `output_of_process`.

    Raises:
        InputError: as `output_of_process`.
    """
    with np.load(BytesIO(output_of_process(module, path, extra, expected)), allow_pickle=False) as arrays:
        found: dict[str, Any] = dict(arrays)
    more = {name.removeprefix(ATTRIBUTE): found.pop(name) for name in [*found] if name.startswith(ATTRIBUTE)}
    found["dropped"] = int(found["dropped"])
    return Strands(source=str(path), attributes=StrandAttributes.of_arrays(more), **found)


def output_of_process(module: str, path: Path, extra: str, expected: str) -> bytes:
    """What a module writes of a file.

    Args:
        module: run as `python -m module FILE`; ends with `serve`.
        extra: the extra of the package that the module needs, a key of `LIBRARIES`.
        expected: what the file should be, for the error.

    Raises:
        InputError: the library is not installed; what the module refuses; a file that takes more time or memory than
            its size accounts for, or on which the library ends its process.
    """
    check_input_file(path, expected)
    require_extra(extra, path)
    seconds = FREE_SECONDS + SECONDS_PER_BYTE * path.stat().st_size
    command = [sys.executable, "-P", "-m", module, str(path.absolute())]
    try:
        ended = subprocess.run(
            command, capture_output=True, check=False, timeout=WALL_TIME * seconds, env=library_environment()
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(path, expected, f"one that is not read within {WALL_TIME * seconds:.0f} s") from error
    if ended.returncode == REFUSED:
        raise InputError(path, *json.loads(ended.stdout))
    if ended.returncode:
        raise InputError(path, expected, _how_it_ended(ended.returncode, ended.stderr, LIBRARIES[extra]))
    return ended.stdout


def _how_it_ended(code: int, said: bytes, library: str) -> str:
    """What to say of a process that neither read nor refused the file."""
    if b"MemoryError" in said or b"bad_alloc" in said:
        return "one that takes more memory than its size accounts for"
    if code == -getattr(signal, "SIGXCPU", 0):
        return "one that takes more time than its size accounts for"
    if code < 0:
        return f"one on which the {library} library ends with {signal.Signals(-code).name}"
    lines = said.decode(errors="replace").strip().splitlines()
    return f"one that could not be read: {lines[-1] if lines else code}"


def serve(path: Path, read: Callable[[Path], Value], write: Callable[[Value, BinaryIO], object]) -> int:
    """Write what is read to the standard output, or as JSON what was expected and what was found.

    Returns:
        The exit code: 0, or `REFUSED`.
    """
    with _results() as output:
        _limit_this_process(path.stat().st_size)
        try:
            value = read(path)
        except InputError as error:
            output.write(json.dumps([error.expected, error.found]).encode())
            return REFUSED
        write(value, output)
    return 0


def write_strands(strands: Strands, output: BinaryIO) -> None:
    """Write strands as `.npz`."""
    numbers = {"points": strands.points, "counts": strands.counts, "dropped": np.array(strands.dropped)}
    if strands.times is not None:
        numbers["times"] = strands.times
    more = {f"{ATTRIBUTE}{name}": values for name, values in strands.attributes.arrays().items()}
    np.savez(output, **numbers, **more, **held_parts_of(strands))  # type: ignore[arg-type]  # taken for allow_pickle


@contextmanager
def _results() -> Iterator[BinaryIO]:
    """The standard output; what the library prints there goes to the error stream."""
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)
        yield output


def _limit_this_process(file_size: int) -> None:
    """Limit memory and processor time to what a stage of this size [bytes] may need, where the system can."""
    try:
        import resource
    except ImportError:
        return
    memory = FREE_BYTES + BYTES_PER_BYTE * file_size
    seconds = round(FREE_SECONDS + SECONDS_PER_BYTE * file_size)
    for limit, value in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
    ):
        _, most = resource.getrlimit(limit)
        resource.setrlimit(limit, (value if most == resource.RLIM_INFINITY else min(value, most), most))
