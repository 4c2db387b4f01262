"""Damaged files against every reader: `python -m tests.fuzzing.fuzz --mutants 10000`, or `make fuzz`.

A reader may take a file or refuse it by an `InputError` of one line, in bounded time and memory. Everything else is a
fault. The same number and seed give the same mutants.
"""

import argparse
import random
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fuzzing.mutations import mutant
from tests.fuzzing.reading import FATAL, Outcome, ReaderProcess, folder_for_files
from tests.fuzzing.seeds import seeds

ALIGNED = "npz aligned"
"""Strands that are registered from an unknown frame, which takes half a second: a tenth of the mutants."""
BATCH_FILES, BATCH_BYTES = 64, 1 << 24
"""Mutants that lie on the disk at once."""
ISOLATED = ("abc", "usda", "usdc", "usdz")
"""Formats that are read in a process of their own: its end, after 3 s and 2 s a megabyte at most, is a refusal."""


@dataclass
class Tally:
    """What became of the mutants of a format.

    Attributes:
        outcomes: how many were read, refused, raised another error, were read with numbers that are not finite, took
            too long, or ended the process.
        seconds: processor time of the files that were read or refused.
        slowest: of these [s].
        faults: index of the mutant, and what happened.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    slowest: float = 0.0
    faults: list[tuple[int, str]] = field(default_factory=list)

    def add(self, index: int, found: Outcome, is_fault: bool) -> None:
        self.outcomes[found["outcome"]] += 1
        if is_fault:
            self.faults.append((index, f"{found['outcome']}: {found['said']}"))
        else:
            self.seconds += found["seconds"]
            self.slowest = max(self.slowest, found["seconds"])


def mutants(name: str, count: int, seed: int) -> Iterator[bytes]:
    """Damaged files of a format."""
    _, files = seeds()[name]
    for index in range(count):
        random_ = random.Random(f"{seed} {name} {index}")
        yield mutant(random_.choice(files), random_)


def fuzz(names: Iterable[str], count: int, seed: int = 0, keep: Path | None = None) -> dict[str, Tally]:
    """Read mutants of some formats.

    Args:
        count: of each format; a tenth of it of `ALIGNED`.
        keep: folder for the files of faults.
    """
    reader = ReaderProcess()
    try:
        with TemporaryDirectory(dir=folder_for_files()) as folder:
            return {name: _tally(name, count, seed, reader, Path(folder), keep) for name in names}
    finally:
        reader.stop()


def _tally(name: str, count: int, seed: int, reader: ReaderProcess, folder: Path, keep: Path | None) -> Tally:
    suffix, files = seeds()[name]
    tally, index = Tally(), 0
    list(reader.read(name, _on_disk(files, name, folder), is_damaged=False))
    for batch in _batches(mutants(name, _share(name, count), seed)):
        for content, found in zip(batch, reader.read(name, _on_disk(batch, name, folder)), strict=True):
            tally.add(index, found, _is_fault(name, found["outcome"]))
            if keep is not None and tally.faults[-1:] and tally.faults[-1][0] == index:
                (keep / f"{name.replace(' ', '_')}_{seed}_{index}{suffix}").write_bytes(content)
            index += 1
    return tally


def _batches(contents: Iterable[bytes]) -> Iterator[list[bytes]]:
    batch: list[bytes] = []
    for content in contents:
        batch.append(content)
        if len(batch) == BATCH_FILES or sum(map(len, batch)) > BATCH_BYTES:
            yield batch
            batch = []
    if batch:
        yield batch


def _on_disk(batch: Sequence[bytes], name: str, folder: Path) -> list[Path]:
    """A file in a folder of its own for each."""
    stem, suffix = "checkpoint" if name == "checkpoint" else "mutant", seeds()[name][0]
    paths = [folder / str(number) / f"{stem}{suffix}" for number in range(len(batch))]
    for path, content in zip(paths, batch, strict=True):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    return paths


def _share(name: str, count: int) -> int:
    return -(-count // 10) if name == ALIGNED else count


def _row(name: str, tally: Tally) -> str:
    """A line of the table; faults by their kinds."""
    total = tally.outcomes.total()
    ended = sum(tally.outcomes[outcome] for outcome in FATAL) if name in ISOLATED else "-"
    times = f"{1000 * tally.seconds / max(total - len(tally.faults), 1):.2f}", f"{1000 * tally.slowest:.0f}"
    kinds = Counter(said.partition(":")[0] for _, said in tally.faults)
    faults = ", ".join([str(len(tally.faults)), *(f"{kind} {number}" for kind, number in sorted(kinds.items()))])
    cells = (name, total, tally.outcomes["read"], tally.outcomes["refused"], ended, *times, faults)
    return f"| {' | '.join(map(str, cells))} |"


def _is_fault(name: str, outcome: str) -> bool:
    return outcome not in ("read", "refused") and not (outcome in FATAL and name in ISOLATED)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=1000, help=f"of each format, a tenth of them of '{ALIGNED}'")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", action="append", choices=sorted(seeds()), help="default: all of them")
    parser.add_argument("--keep", type=Path, help="folder for the files of faults")
    options = parser.parse_args()
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    tallies = fuzz(options.format or seeds(), options.mutants, options.seed, options.keep)
    print("| format | mutants | read | refused | ended the library | mean [ms] | slowest [ms] | faults |")
    print("|---|---|---|---|---|---|---|---|")
    for name, tally in tallies.items():
        print(_row(name, tally))
    print(f"\n{sum(tally.outcomes.total() for tally in tallies.values())} mutants in {time.monotonic() - start:.0f} s")
    faults = [(name, *fault) for name, tally in tallies.items() for fault in tally.faults]
    for name, index, said in faults:
        print(f"{name}, mutant {index}: {said}", file=sys.stderr)
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
