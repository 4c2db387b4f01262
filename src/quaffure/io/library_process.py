"""Processes for libraries that end the process on what they cannot read or write."""

import os
import sys


def library_environment() -> dict[str, str]:
    """Modules are found where this process finds them; threads of numpy would each reserve memory."""
    folders = os.pathsep.join(folder for folder in sys.path if folder)
    return os.environ | {"PYTHONPATH": folders, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
