"""The one thread that drapes for the live page."""

import sys
import threading
import traceback
from collections.abc import Callable

Job = Callable[[], None]


class DrapingThread:
    """Runs jobs one after another; a job requested again before it started replaces the older one and goes to the end.

    So dragging a slider leaves one drape to do and not a hundred. One thread runs all jobs because numba's own pool
    of threads must not be used from two threads at once.

    Args:
        on_error: called with every exception of a job; the thread continues, even if this raises too.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._jobs: dict[str, Job] = {}
        self._changed = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="quaffure-view", daemon=True)
        self._thread.start()

    def request(self, kind: str, job: Job) -> None:
        """Run a job after all that wait; it replaces one of the same kind that has not started."""
        with self._changed:
            self._jobs.pop(kind, None)
            self._jobs[kind] = job
            self._changed.notify()

    def stop(self, seconds: float = 10.0) -> None:
        """Drop the waiting jobs and end after the running one, but wait no longer than this for it."""
        with self._changed:
            self._stopped = True
            self._jobs.clear()
            self._changed.notify()
        self._thread.join(seconds)

    def _run(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except Exception as error:
                self._report(error)

    def _report(self, error: Exception) -> None:
        try:
            self._on_error(error)
        except Exception as another:
            traceback.print_exception(another, file=sys.stderr)

    def _next(self) -> Job | None:
        with self._changed:
            self._changed.wait_for(lambda: self._jobs or self._stopped)
            return None if self._stopped else self._jobs.pop(next(iter(self._jobs)))
