"""Names of temporary files, and the removal of what killed processes left of them."""

import os
import re
import secrets
import socket
import time
from functools import cache
from pathlib import Path

from quaffure.io.kept_folder import PATTERN as FRAMES
from quaffure.io.kept_folder import remove_abandoned

PREFIX = ".quaffure-"
HOST = re.sub(r"\W", "_", socket.gethostname())[:40]
OLDEST = 24 * 3600.0
"""Age from which a temporary file of another machine is a leftover: its processes cannot be asked for [s]."""
_NAME = re.compile(rf"{re.escape(PREFIX)}(?P<host>\w*)-(?P<process>\d+)-[0-9a-f]{{8}}")


def temporary_in(folder: Path, suffix: str) -> Path:
    """A path for a new file; libraries select the format by its suffix."""
    return folder / f"{PREFIX}{HOST}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"


@cache
def sweep_temporary_files(folder: Path) -> None:
    """Remove temporary files of processes that have ended, and folders of frames that they left without a whole batch;
    once for a folder, as some hold thousands of files."""
    try:
        leftovers = [path for path in folder.glob(f"{PREFIX}*") if _is_leftover(path)]
        for path in leftovers:
            path.unlink(missing_ok=True)
        for path in [*folder.glob(FRAMES)]:
            remove_abandoned(path)
    except OSError:
        pass  # not ours to remove, or gone by now


def _is_leftover(path: Path) -> bool:
    match = _NAME.match(path.name)
    if match is None:
        return False
    if match["host"] == HOST and os.name == "posix":  # elsewhere os.kill ends the process
        return not _is_running(int(match["process"]))
    return time.time() - path.stat().st_mtime > OLDEST


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # of another user
        pass
    return True
