"""When numba compiles kernels that its cache does not hold, and how long it takes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

from numba.core.event import Event, Listener, TimingListener, register, unregister


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


class CompileNotice(Listener):
    """Calls a function once, when numba begins to compile a kernel that its cache does not hold.

    Args:
        say: prints that it does.
    """

    def __init__(self, say: Callable[[], object]) -> None:
        self._say: Callable[[], object] | None = say

    def on_start(self, event: Event) -> None:
        if self._say is not None:
            say, self._say = self._say, None
            say()

    def on_end(self, event: Event) -> None:
        pass


@contextmanager
def announced_compiling(say: Callable[[], object]) -> Iterator[None]:
    """While the block runs, call `say` where a kernel is compiled, once."""
    notice = CompileNotice(say)
    register("numba:compile", notice)  # type: ignore[no-untyped-call]
    try:
        yield
    finally:
        unregister("numba:compile", notice)  # type: ignore[no-untyped-call]


@cache
def _listener(kind: str) -> TimingListener:
    listener = TimingListener()  # type: ignore[no-untyped-call]
    register(kind, listener)  # type: ignore[no-untyped-call]
    return listener
