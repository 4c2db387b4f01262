"""Strands of an OpenUSD file, which a process of its own reads (`quaffure.io.usd_curves`)."""

import json
import os
import signal
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np

from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.strands import Strands
from quaffure.input_file import check_input_file

PREFIX = "quaffure:"
"""Prefix of the primvars of held parts."""
# A text file takes some 6 times its size, and 0.2 s for a megabyte.
FREE_BYTES, BYTES_PER_BYTE = 2 << 30, 32
"""Limit of the process's memory: of any file [bytes], and for each byte of the file."""
FREE_SECONDS, SECONDS_PER_BYTE = 3.0, 2e-6
"""Limit of its processor time: of any file [s], and for each byte of the file [s]."""
WALL_TIME = 5.0
"""Limit of the wall time, in limits of the processor time: a reference may name a FIFO, and machines may be busy."""
REFUSED = 3
"""Exit code of the process with an error of the file's."""


def read_usd_strands(path: Path) -> Strands:
    """All curves of a stage in world space, at each one's first time sample; the file's units and up axis are kept.

    Cubic bases and NURBS are evaluated, instances are read, and hidden curves, proxies and guides are left out where
    there are others.

    Raises:
        InputError: the USD library is not installed; not a USD file, one that takes more time or memory than its size
            accounts for, or no curves in it.
    """
    expected = "a USD file"
    check_input_file(path, expected)
    require_extra("usd", path)
    seconds = FREE_SECONDS + SECONDS_PER_BYTE * path.stat().st_size
    command = [sys.executable, "-P", "-m", "quaffure.io.usd_curves", str(path.absolute())]
    try:
        ended = subprocess.run(
            command, capture_output=True, check=False, timeout=WALL_TIME * seconds, env=_environment()
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(path, expected, f"one that is not read within {WALL_TIME * seconds:.0f} s") from error
    if ended.returncode == REFUSED:
        raise InputError(path, *json.loads(ended.stdout))
    if ended.returncode:
        raise InputError(path, expected, _how_it_ended(ended.returncode, ended.stderr))
    with np.load(BytesIO(ended.stdout), allow_pickle=False) as arrays:
        return Strands(source=str(path), **arrays)


def _environment() -> dict[str, str]:
    """Modules are found where this process finds them; threads of numpy would each reserve memory."""
    folders = os.pathsep.join(folder for folder in sys.path if folder)
    return os.environ | {"PYTHONPATH": folders, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def _how_it_ended(code: int, said: bytes) -> str:
    """What to say of a process that neither read nor refused the file."""
    if b"MemoryError" in said or b"bad_alloc" in said:
        return "one that takes more memory than its size accounts for"
    if code == -getattr(signal, "SIGXCPU", 0):
        return "one that takes more time than its size accounts for"
    if code < 0:
        return f"one on which the USD library ends with {signal.Signals(-code).name}"
    lines = said.decode(errors="replace").strip().splitlines()
    return f"one that could not be read: {lines[-1] if lines else code}"
