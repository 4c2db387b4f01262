"""Damaged files of every format, and whether the harness that makes them finds a fault."""

import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from quaffure.body import BodyModel
from quaffure.errors import InputError
from quaffure.io.read_strands import STRAND_READERS

pytest.importorskip("resource", reason="limits of a process: not on Windows")

from tests.fuzzing import fuzz as harness
from tests.fuzzing.fuzz import REGISTERED, ReaderProcess, fuzz, mutants
from tests.fuzzing.mutations import mutant
from tests.fuzzing.reader_process import outcome_of, readers
from tests.fuzzing.seeds import seeds

MUTANTS = 200
FORMATS = tuple(seeds())


def test_seeds_are_read_by_every_reader(body: BodyModel, tmp_path: Path) -> None:
    of = readers(body)
    assert set(of) == set(FORMATS)
    assert {suffix for suffix, _ in seeds().values()} >= set(STRAND_READERS) - {".usd", ".abc"}
    for name, (suffix, files) in seeds().items():
        path = tmp_path / f"checkpoint{suffix}"
        for content in files:
            path.write_bytes(content)
            assert outcome_of(of[name], path)["outcome"] == "read", (name, outcome_of(of[name], path))


def test_damaged_files_are_read_or_refused(tmp_path: Path) -> None:
    tallies = fuzz(FORMATS, MUTANTS, keep=tmp_path)
    for name, tally in tallies.items():
        print(name, dict(tally.outcomes), *tally.faults)
        count = tally.outcomes.total()
        assert count == (MUTANTS // 10 if name == REGISTERED else MUTANTS)
        assert tally.outcomes["refused"] > count // 10, name
    assert {name: tally.faults for name, tally in tallies.items() if tally.faults} == {}
    assert sum(tally.outcomes["read"] for tally in tallies.values()) > MUTANTS


def test_mutants_are_the_same_again_and_differ_among_themselves() -> None:
    for name in FORMATS:
        made = list(mutants(name, 20, seed=3))
        assert made == list(mutants(name, 20, seed=3))
        assert len(set(made)) > 10
        assert made != list(mutants(name, 20, seed=4))


def test_changes_reach_behind_checksums() -> None:
    """Most mutants of an archive are still archives, with arrays that have changed."""
    (content,) = seeds()["npz drape"][1]
    with_good_start = [mutant(content, random.Random(index)) for index in range(60)]
    assert sum(made.startswith(b"PK\x03\x04") for made in with_good_start) > 30


def raises(path: Path) -> None:
    raise KeyError("a fault")


def says_two_lines(path: Path) -> None:
    raise InputError(path, "one line", "two\nof them")


def reads(path: Path) -> None:
    path.read_bytes()


@pytest.mark.parametrize(
    ("read", "outcome"),
    [(raises, "raised"), (says_two_lines, "raised"), (reads, "read")],
    ids=["another error", "two lines", "reading"],
)
def test_outcomes_tell_faults(read: Callable[[Path], None], outcome: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    assert outcome_of(read, path)["outcome"] == outcome


FAULTY_PROCESS = """
import json, os, sys, time
print("ready", flush=True)
for line in sys.stdin:
    content = open(json.loads(line)[1], "rb").read()
    if content == b"0":
        os.abort()
    if content == b"1":
        time.sleep(100)
    print(json.dumps({"outcome": "raised" if content == b"2" else "read", "said": "", "seconds": 0.0}), flush=True)
"""


def test_a_reader_that_ends_hangs_or_raises_is_a_fault_and_the_next_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []
    start = harness.subprocess.Popen

    def faulty(command: list[str], **options: object) -> object:
        started.append(command)
        return start([command[0], "-c", FAULTY_PROCESS], **options)  # type: ignore[call-overload]

    monkeypatch.setattr(harness.subprocess, "Popen", faulty)
    monkeypatch.setattr(harness, "SECONDS", 1.0)
    monkeypatch.setattr(harness, "mutants", lambda name, count, seed: [b"%d" % index for index in range(count)])
    begin = time.monotonic()
    tally = fuzz(["hair"], 4, keep=tmp_path)["hair"]
    assert time.monotonic() - begin < 30
    assert dict(tally.outcomes) == {"ended": 1, "too long": 1, "raised": 1, "read": 1}
    assert [index for index, _ in tally.faults] == [0, 1, 2]
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"hair_0_{index}.hair" for index in range(3)]
    assert len(started) == 3
    assert fuzz(["usda"], 1)["usda"].faults == []  # the library may end its own process


def test_memory_is_limited(tmp_path: Path) -> None:
    """A file that claims more than the limit must be refused by its reader, not by the system."""
    reader = ReaderProcess()
    try:
        path = tmp_path / "hair.csv"
        path.write_text("0 " * 10)
        assert reader.read("csv", path)["outcome"] == "read"
        assert reader._process is not None
        limits = Path(f"/proc/{reader._process.pid}/limits")
        if limits.exists():
            (line,) = (line for line in limits.read_text().splitlines() if line.startswith("Max address space"))
            assert "unlimited" not in line
            os.kill(reader._process.pid, 0)
    finally:
        reader.stop()
