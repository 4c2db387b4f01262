"""Whether numba has compiled kernels before, on this machine and for these sources."""

from typing import Any


def is_cached(kernel: Any) -> bool:
    """Whether numba's cache holds the kernel, compiled from the source as it is; True where numba compiles nothing.

    numba itself decides whether a source is the one of before: by its time, and by its content from numba 0.62 on.
    """
    if not hasattr(kernel, "stats"):
        return True
    # No public name says it. `_load_index` returns nothing where the index is of another source or another numba.
    return bool(kernel._cache._cache_file._load_index())
