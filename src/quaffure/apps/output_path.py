"""Checks of the files that a command is asked to write, before the work for them."""

from pathlib import Path

from quaffure.errors import InputError
from quaffure.io.atomic import check_folder_of


def check_output(path: Path, *suffixes: str) -> None:
    """Refuse a file that could not be written.

    Raises:
        InputError: another suffix, no folder to write into, or a folder of that name.
    """
    if path.suffix.lower() not in suffixes:
        raise InputError(path, f"an output of suffix {', '.join(suffixes)}", f"suffix '{path.suffix}'")
    check_folder_of(path)
