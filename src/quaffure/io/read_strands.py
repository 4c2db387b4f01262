"""Strands from a file of any format that is read here."""

from collections.abc import Callable
from pathlib import Path

from quaffure.errors import InputError
from quaffure.hair.strands import Strands
from quaffure.io.ct2hair import read_ct2hair
from quaffure.io.hair import read_hair
from quaffure.io.hairsalon import read_hairsalon
from quaffure.io.npz_strands import read_npz_strands
from quaffure.io.tressfx import read_tressfx


def _read_usd(path: Path) -> Strands:
    from quaffure.io.usd import read_usd_strands

    return read_usd_strands(path)


STRAND_READERS: dict[str, Callable[[Path], Strands]] = {
    ".bin": read_ct2hair,
    ".data": read_hairsalon,
    ".hair": read_hair,
    ".npz": read_npz_strands,
    ".tfx": read_tressfx,
    ".usd": _read_usd,
    ".usda": _read_usd,
    ".usdc": _read_usd,
}


def read_strands(path: Path) -> Strands:
    """Strands of a file, in its own units and axes; its suffix, in any case, selects the format.

    Raises:
        InputError: no such file, a folder, a suffix without a reader, or what the format's reader refuses.
    """
    supported = f"a strand file ({', '.join(sorted(STRAND_READERS))})"
    if path.is_dir():
        raise InputError(path, supported, "a folder")
    if not path.is_file():
        raise InputError(path, supported, "no such file")
    reader = STRAND_READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, supported, f"suffix {path.suffix!r}")
    return reader(path)
