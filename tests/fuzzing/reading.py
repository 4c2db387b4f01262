"""Files read by a process of its own, within limits."""

import json
import os
import selectors
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import gettempdir
from typing import Any

ROOT = Path(__file__).parents[2]
SECONDS = 5.0
"""Limit of the processor time of one file: the machine may be busy."""
STALL_SECONDS = 60.0
"""Limit of the wall time of one file, for a reader that waits."""
START_SECONDS = 600.0
"""Limit of the wall time of a start, and of an undamaged file, for which kernels may have to be compiled."""
IN_MEMORY = Path("/dev/shm")
"""Folder for files, where it can be written: the disk takes longer than most readers do."""
FATAL = ("ended", "too long")
"""Outcomes after which the next file needs another process."""
Outcome = dict[str, Any]


def folder_for_files() -> Path:
    return IN_MEMORY if os.access(IN_MEMORY, os.W_OK) else Path(gettempdir())


class ReaderProcess:
    """`tests.fuzzing.reader_process`, started anew when it has ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._pending = b""

    def read(self, name: str, paths: Sequence[Path], is_damaged: bool = True) -> Iterator[Outcome]:
        """Outcome of each file, with what was said and the processor time.

        Many at once: on a busy machine, handing one over takes longer than most readers do.
        """
        done = 0
        while done < len(paths):
            self._ask([name, [str(path) for path in paths[done:]], SECONDS if is_damaged else 0])
            while done < len(paths):
                outcome = self._answer(STALL_SECONDS if is_damaged else START_SECONDS)
                done += 1
                yield outcome
                if outcome["outcome"] in FATAL:
                    break

    def stop(self) -> None:
        if self._process is not None:
            with suppress(ProcessLookupError):  # it has ended
                os.killpg(self._process.pid, signal.SIGKILL)  # with the child that reads
            self._process.communicate()
            self._process, self._pending = None, b""

    def _ask(self, question: list[object]) -> None:
        if self._process is None:
            self._start()
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(question).encode() + b"\n")
        self._process.stdin.flush()

    def _answer(self, seconds: float) -> Outcome:
        assert self._process is not None
        line = self._line(seconds)
        if line is None:
            self.stop()
            return {"outcome": "too long", "said": f"nothing in {seconds:g} s", "seconds": 0.0}
        if not line:
            code = self._process.wait()
            self.stop()
            return {"outcome": "ended", "said": f"the process ended with {code}", "seconds": 0.0}
        outcome: Outcome = json.loads(line)
        return outcome

    def _start(self) -> None:
        # Without threads, which a child that is forked would lack.
        threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzzing.reader_process"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, **threads, "TMPDIR": str(folder_for_files())},
        )
        line = self._line(START_SECONDS)
        if line != b"ready":
            raise RuntimeError(f"the reading process did not start: {line!r}")

    def _line(self, seconds: float) -> bytes | None:
        """The next line; empty at the end of the stream, None where nothing comes in time."""
        assert self._process is not None
        assert self._process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._pending:
                if not selector.select(seconds):
                    return None
                part = os.read(self._process.stdout.fileno(), 1 << 16)
                if not part:
                    return b""
                self._pending += part
        line, _, self._pending = self._pending.partition(b"\n")
        return line
