"""Whether numba has compiled kernels before, on this machine and for these sources, and how long it takes now."""

from functools import cache
from typing import Any, NamedTuple

from numba.core.event import TimingListener, register


class KernelSeconds(NamedTuple):
    """Wall time that numba has taken in this process since it was first asked for [s].

    Attributes:
        total: in which kernels were compiled, or read from the cache.
        compiling: of that, in which they were compiled.
    """

    total: float
    compiling: float


def kernel_seconds() -> KernelSeconds:
    """The time so far; 0 at the first call."""
    return KernelSeconds(*(_seconds(kind) for kind in ("numba:compiler_lock", "numba:compile")))


def _seconds(kind: str) -> float:
    listener = _listener(kind)
    return float(listener.duration) if listener.done else 0.0


@cache
def _listener(kind: str) -> TimingListener:
    listener = TimingListener()  # type: ignore[no-untyped-call]
    register(kind, listener)  # type: ignore[no-untyped-call]
    return listener


def is_cached(kernel: Any) -> bool:
    """Whether numba's cache holds the kernel, compiled from the source as it is; True where numba compiles nothing.

    numba itself decides whether a source is the one of before: by its time, and by its content from numba 0.62 on.
    """
    if not hasattr(kernel, "stats"):
        return True
    # No public name says it. `_load_index` returns nothing where the index is of another source or another numba.
    return bool(kernel._cache._cache_file._load_index())
