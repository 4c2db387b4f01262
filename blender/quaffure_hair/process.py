"""Quaffure in a process of its own."""

import os
import re
import subprocess
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue

PROGRESS = re.compile(r"^(\d+) of (\d+)")
MISSING = (
    "expected a Python with quaffure in the preferences of Quaffure Hair (pip install 'quaffure[usd]'), found {found}"
)


class QuaffureError(Exception):
    """One line about what went wrong."""


class Run:
    """A command of quaffure that runs while Blender goes on.

    Args:
        python: the executable.
        arguments: of `python -m quaffure`.

    Raises:
        QuaffureError: no such executable.
    """

    def __init__(self, python: str, arguments: Sequence[str]) -> None:
        # Blender's own modules are none of that Python's.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        command = [os.path.expanduser(python), "-m", "quaffure", *arguments]
        try:
            self._process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
            )
        except OSError as error:
            raise QuaffureError(MISSING.format(found=f"'{python}' ({error.strerror})")) from error
        self._lines: SimpleQueue[str] = SimpleQueue()
        self._said: list[str] = []
        self._threads = [
            threading.Thread(target=self._read, args=(self._process.stdout, self._lines.put), daemon=True),
            threading.Thread(target=self._read, args=(self._process.stderr, self._said.append), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @staticmethod
    def _read(stream, take) -> None:
        with stream:
            for line in stream:
                take(line.strip())

    def progress(self) -> Iterator[tuple[int, int]]:
        """Finished and all frames, of every line about them since the last call."""
        while True:
            try:
                match = PROGRESS.match(self._lines.get_nowait())
            except Empty:
                return
            if match:
                yield int(match[1]), int(match[2])

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def cancel(self) -> None:
        """End it; quaffure removes what it was writing."""
        self._process.terminate()
        self._process.wait()

    def finish(self) -> None:
        """Wait for its end.

        Raises:
            QuaffureError: it has failed.
        """
        code = self._process.wait()
        for thread in self._threads:
            thread.join()
        if code:
            said = " ".join(self._said[-1:]) or f"exit code {code}"
            missing = "No module named" in said and "quaffure" in said
            raise QuaffureError(MISSING.format(found="one without it") if missing else said)


def run(python: str, arguments: Sequence[str | Path]) -> None:
    """Run a command to its end.

    Raises:
        QuaffureError: it has failed.
    """
    Run(python, [*map(str, arguments)]).finish()
