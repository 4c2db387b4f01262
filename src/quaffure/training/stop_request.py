"""A training that is asked to stop ends its step first: weights in the middle of an update are of no use."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
"""The last one comes when a terminal is closed; Windows has none."""
EXIT_CODE_BASE = 128
"""A process that a signal ended has this exit code and the signal's number."""


class StopRequest:
    """Whether the process was asked to stop.

    Attributes:
        signal: the number of the first signal; None without one.
    """

    def __init__(self) -> None:
        self.signal: int | None = None

    @property
    def is_made(self) -> bool:
        return self.signal is not None

    def follow(self) -> None:
        """End as the signal would have ended the process, where there was one.

        Raises:
            KeyboardInterrupt: after SIGINT.
            SystemExit: after another signal.
        """
        if self.signal == signal.SIGINT:
            raise KeyboardInterrupt
        if self.signal is not None:
            sys.exit(EXIT_CODE_BASE + self.signal)


@contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Note the first of `SIGNALS` in the block instead of raising it; the second one does what it did before. A signal
    that is ignored (`nohup`) stays so."""
    request, before = StopRequest(), dict[int, Any]()
    if threading.current_thread() is not threading.main_thread():
        yield request  # no signals arrive there
        return

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(number: int, frame: FrameType | None) -> None:
        request.signal = number
        restore()
        with suppress(OSError):  # a terminal that is gone
            print("stopping after this step; once more stops at once", file=sys.stderr)

    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, note)
    try:
        yield request
    finally:
        restore()
