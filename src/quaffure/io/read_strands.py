"""Strands from a file of any format that is read here."""

from collections.abc import Callable
from pathlib import Path

from quaffure.errors import InputError
from quaffure.hair.strands import Strands
from quaffure.input_file import check_input_file
from quaffure.io.alembic_process import read_alembic_strands
from quaffure.io.counted_strands import read_ct2hair, read_hairsalon
from quaffure.io.hair import read_hair
from quaffure.io.npz_strands import read_npy_strands, read_npz_strands
from quaffure.io.ply_strands import read_ply
from quaffure.io.tressfx import read_tressfx
from quaffure.io.usd_process import read_usd_strands

STRAND_READERS: dict[str, Callable[[Path], Strands]] = {
    ".abc": read_alembic_strands,
    ".bin": read_ct2hair,
    ".data": read_hairsalon,
    ".hair": read_hair,
    ".npy": read_npy_strands,
    ".npz": read_npz_strands,
    ".ply": read_ply,
    ".tfx": read_tressfx,
    ".usd": read_usd_strands,
    ".usda": read_usd_strands,
    ".usdc": read_usd_strands,
    ".usdz": read_usd_strands,
}


def read_strands(path: Path) -> Strands:
    """Strands of a file, in its own units and axes; its suffix, in any case, selects the format. Alembic files that
    this package wrote for Unreal, left-handed, are read right-handed (`read_alembic_strands`).

    Raises:
        InputError: no such file, a folder, a suffix without a reader, or what the format's reader refuses.
    """
    supported = f"a strand file ({', '.join(sorted(STRAND_READERS))})"
    check_input_file(path, supported)
    if path.suffix.lower() not in STRAND_READERS:
        raise InputError(path, supported, f"suffix {path.suffix!r}")
    return STRAND_READERS[path.suffix.lower()](path)
