"""Whether numba has compiled kernels before, on this machine and for these sources."""

from pathlib import Path
from typing import Any


def is_cached(kernel: Any) -> bool:
    """Whether numba's cache has an index for the file of a kernel, younger than the file; True where numba compiles
    nothing.

    numba itself says where its cache is: `NUMBA_CACHE_DIR`, the `__pycache__` beside the source, or a folder of the
    user where that cannot be written.
    """
    if not hasattr(kernel, "stats"):
        return True
    source, cache = Path(kernel.py_func.__code__.co_filename), Path(kernel.stats.cache_path)
    changed = source.stat().st_mtime
    return any(index.stat().st_mtime >= changed for index in cache.glob(f"{source.stem}.*.nbi"))
