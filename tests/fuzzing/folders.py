"""A folder as the bytes of one file, so that its files are damaged as others are."""

from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar
from zipfile import ZipFile, ZipInfo

MARK = b"a folder"
"""Comment at the end of the archive."""
Read = TypeVar("Read")


def packed(files: Mapping[str, bytes]) -> bytes:
    out = BytesIO()
    with ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(ZipInfo(name), content)
        archive.comment = MARK
    return out.getvalue()


def unpacked(content: bytes) -> dict[str, bytes]:
    with ZipFile(BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def is_folder(content: bytes) -> bool:
    return content.endswith(MARK)


def packed_folder(make: Callable[[Path], object]) -> bytes:
    """The files that `make` leaves in a new folder."""
    with TemporaryDirectory() as folder:
        make(Path(folder))
        return packed({path.name: path.read_bytes() for path in sorted(Path(folder).iterdir()) if path.is_file()})


def of_folder(read: Callable[[Path], Read]) -> Callable[[Path], Read]:
    """A reader of a packed folder, from one of the folder."""

    def read_packed(path: Path) -> Read:
        with TemporaryDirectory() as folder:
            for name, content in unpacked(path.read_bytes()).items():
                (Path(folder) / name).write_bytes(content)
            return read(Path(folder))

    return read_packed
