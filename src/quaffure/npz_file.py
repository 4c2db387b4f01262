"""Arrays of an `.npz` file: the size of each is checked before it is allocated, pickled objects are never loaded."""

import math
from collections.abc import Collection
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from quaffure.errors import InputError

# The most that deflate can shrink (zlib's technical notes); a member that claims more has a damaged size.
MOST_COMPRESSION = 1032


def read_npz(path: Path, names: Collection[str], kind: str = ".npz file", types: str = "fiu") -> dict[str, np.ndarray]:
    """The arrays of an `.npz` file among `names`.

    Args:
        kind: of the file, for messages.
        types: kinds of numpy dtypes that an array may have.

    Raises:
        InputError: the file is missing, not an `.npz` or damaged, or an array has another type.
    """
    try:
        with ZipFile(path) as archive:
            present = [name for name in names if f"{name}.npy" in archive.namelist()]
            return {name: _array(path, archive, name, types) for name in present}
    except InputError:
        raise
    except OSError as error:
        raise InputError(path, f"a readable {kind}", error.strerror or str(error)) from error
    # On damaged bytes zipfile, zlib and numpy's header parser raise some ten unrelated types between them.
    except Exception as error:
        raise InputError(path, f"an undamaged {kind}", str(error) or type(error).__name__) from error


def read_complete_npz(path: Path, names: Collection[str], kind: str) -> dict[str, np.ndarray]:
    """The arrays `names` of an `.npz` file, of numbers or text.

    Raises:
        InputError: as `read_npz`, or an array is missing.
    """
    arrays = read_npz(path, names, kind, "fiuU")
    missing = [name for name in names if name not in arrays]
    if missing:
        raise InputError(path, f"a {kind} with the arrays {', '.join(names)}", f"no array {', '.join(missing)}")
    return arrays


def _array(path: Path, archive: ZipFile, name: str, types: str) -> np.ndarray:
    member = archive.getinfo(f"{name}.npy")
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        # Version 3 exists only for field names beyond Latin-1, and plain arrays have no fields.
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
        if dtype.kind not in types:
            raise InputError(path, f"plain numbers in its array {name}", f"{dtype} (pickled objects are never loaded)")
        expected, found = file.tell() + math.prod(shape) * dtype.itemsize, member.file_size
        if expected != found or found > MOST_COMPRESSION * path.stat().st_size:
            raise InputError(path, f"{expected} bytes to hold its array {name} {list(shape)}", f"{found} bytes")
    with archive.open(member) as file:
        return np.lib.format.read_array(file, allow_pickle=False)
