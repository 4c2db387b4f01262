"""Damaged files against every reader: `python -m tests.fuzzing.fuzz --mutants 10000`, or `make fuzz`.

A reader may take a file or refuse it by an `InputError` of one line, in bounded time and memory. Everything else is a
fault. The same number and seed give the same mutants.
"""

import argparse
import json
import random
import selectors
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from tests.fuzzing.mutations import mutant
from tests.fuzzing.seeds import seeds

ROOT = Path(__file__).parents[2]
SECONDS = 20.0
"""Limit of the wall time of one file; the machine may be busy."""
START_SECONDS = 120.0
REGISTERED = "npz registered"
"""Strands that are registered as well, which takes half a second: a tenth of the mutants."""
ISOLATED = ("abc", "usda", "usdc", "usdz")
"""Formats that are read in a process of their own, whose end is a refusal."""


@dataclass
class Tally:
    """What became of the mutants of a format.

    Attributes:
        outcomes: how many were read, refused, raised another error, took too long, or ended the process.
        slowest: processor time of the slowest file that was read or refused [s].
        faults: index of the mutant, and what happened.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    faults: list[tuple[int, str]] = field(default_factory=list)


class ReaderProcess:
    """`tests.fuzzing.reader_process`, started anew when a file has ended it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def read(self, name: str, path: Path) -> dict[str, object]:
        """Outcome of reading a file, with what was said and the processor time."""
        process = self._running()
        assert process.stdin is not None
        process.stdin.write(json.dumps([name, str(path)]) + "\n")
        process.stdin.flush()
        line = _line_of(process.stdout, SECONDS)
        if line is None:
            self.stop()
            return {"outcome": "too long", "said": f"more than {SECONDS:g} s", "seconds": SECONDS}
        if not line:
            code = process.wait()
            self.stop()
            return {"outcome": "ended", "said": f"the process ended with {code}", "seconds": 0.0}
        found: dict[str, object] = json.loads(line)
        return found

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _running(self) -> "subprocess.Popen[str]":
        if self._process is None:
            command = [sys.executable, "-m", "tests.fuzzing.reader_process"]
            self._process = subprocess.Popen(
                command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )
            line = _line_of(self._process.stdout, START_SECONDS)
            if line != "ready\n":
                raise RuntimeError(f"the reading process did not start: {line!r}")
        return self._process


def _line_of(stream: IO[str] | None, seconds: float) -> str | None:
    """The next line; empty at the end of the stream, None where none comes in time."""
    assert stream is not None
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if selector.select(seconds) else None


def mutants(name: str, count: int, seed: int) -> Iterator[bytes]:
    """Damaged files of a format."""
    _, files = seeds()[name]
    for index in range(count):
        random_ = random.Random(f"{seed} {name} {index}")
        yield mutant(random_.choice(files), random_)


def fuzz(names: Iterable[str], count: int, seed: int = 0, keep: Path | None = None) -> dict[str, Tally]:
    """Read mutants of some formats.

    Args:
        count: of each format; a tenth of it of `REGISTERED`.
        keep: folder for the files of faults.
    """
    reader, tallies = ReaderProcess(), {name: Tally() for name in names}
    try:
        with TemporaryDirectory() as folder:
            for name, tally in tallies.items():
                suffix = seeds()[name][0]
                path = Path(folder) / (f"checkpoint{suffix}" if name == "checkpoint" else f"mutant{suffix}")
                for index, content in enumerate(mutants(name, _share(name, count), seed)):
                    path.write_bytes(content)
                    found = reader.read(name, path)
                    if not _is_fault(name, str(found["outcome"])):
                        tally.slowest = max(tally.slowest, float(str(found["seconds"])))
                    else:
                        tally.faults.append((index, str(found["said"])))
                        if keep is not None:
                            (keep / f"{name.replace(' ', '_')}_{seed}_{index}{suffix}").write_bytes(content)
                    tally.outcomes[str(found["outcome"])] += 1
    finally:
        reader.stop()
    return tallies


def _share(name: str, count: int) -> int:
    return -(-count // 10) if name == REGISTERED else count


def _is_fault(name: str, outcome: str) -> bool:
    return outcome not in ("read", "refused") and not (outcome == "ended" and name in ISOLATED)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=1000, help=f"of each format, a tenth of them of '{REGISTERED}'")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", action="append", choices=sorted(seeds()), help="default: all of them")
    parser.add_argument("--keep", type=Path, help="folder for the files of faults")
    options = parser.parse_args()
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    tallies = fuzz(options.format or seeds(), options.mutants, options.seed, options.keep)
    print("| format | mutants | read | refused | ended the library | slowest [ms] | faults |")
    print("|---|---|---|---|---|---|---|")
    for name, tally in tallies.items():
        cells = (tally.outcomes["read"], tally.outcomes["refused"], tally.outcomes["ended"])
        ended = cells[2] if name in ISOLATED else "-"
        row = (name, tally.outcomes.total(), *cells[:2], ended, f"{1000 * tally.slowest:.0f}", len(tally.faults))
        print("|", " | ".join(map(str, row)), "|")
    print(f"\n{sum(tally.outcomes.total() for tally in tallies.values())} mutants in {time.monotonic() - start:.0f} s")
    faults = [(name, *fault) for name, tally in tallies.items() for fault in tally.faults]
    for name, index, said in faults:
        print(f"{name}, mutant {index}: {said}", file=sys.stderr)
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
