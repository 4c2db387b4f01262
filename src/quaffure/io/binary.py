"""A little-endian file read front to back, with every size checked before anything is allocated."""

from pathlib import Path

import numpy as np

from quaffure.errors import InputError, refused
from quaffure.input_file import check_input_file


class BinaryCursor:
    """The bytes of a file and a position in them.

    Args:
        path: the file; read whole.

    Raises:
        InputError: the file is missing, is a folder or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        check_input_file(path, "a readable file")
        with refused(path, "a readable file", OSError):
            self.content = path.read_bytes()
        self.path, self.offset = path, 0

    def require(self, count: int, bytes_each: int, what: str) -> None:
        """Check that `count` items still fit between here and the end of the file.

        Raises:
            InputError: they do not; names the bytes that were expected and those that were found.
        """
        end = self.offset + count * bytes_each
        if end > len(self.content):
            raise InputError(self.path, f"at least {end} bytes to hold its {what}", f"{len(self.content)} bytes")

    def array(self, dtype: str, count: int, what: str) -> np.ndarray:
        """The next `count` numbers of `dtype`, as a read-only view of shape [count]."""
        self.require(count, np.dtype(dtype).itemsize, what)
        numbers = np.frombuffer(self.content, dtype, count, self.offset)
        self.offset += numbers.nbytes
        return numbers

    def integers(self, dtype: str, count: int, what: str) -> list[int]:
        """The next `count` integers as Python's own, whose products do not overflow."""
        return [int(number) for number in self.array(dtype, count, what)]

    def finish(self) -> None:
        """Check that nothing follows, for formats that say where they end.

        Raises:
            InputError: bytes are left over, so the sizes in the file are not those of its content.
        """
        if self.offset != len(self.content):
            raise InputError(self.path, f"{self.offset} bytes by its own counts", f"{len(self.content)} bytes")
