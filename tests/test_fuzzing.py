"""Damaged files of every format, and whether the harness that makes them finds a fault."""

import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.io.read_strands import STRAND_READERS

pytest.importorskip("resource", reason="limits of a process: not on Windows")

from tests.fuzzing import fuzz as harness
from tests.fuzzing import reading
from tests.fuzzing.finiteness import not_finite
from tests.fuzzing.folders import packed, unpacked
from tests.fuzzing.fuzz import ALIGNED, fuzz, mutants
from tests.fuzzing.mutations import mutant
from tests.fuzzing.reader_process import readers
from tests.fuzzing.reading import ReaderProcess
from tests.fuzzing.seeds import seeds
from tests.fuzzing.serving import outcome_of

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
        assert count == (MUTANTS // 10 if name == ALIGNED else MUTANTS)
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


class TwoLines(InputError):
    def __str__(self) -> str:
        return "one line\nand another"


def says_so_by_itself(path: Path) -> None:
    raise TwoLines(path, "one line", "two")


def reads(path: Path) -> None:
    path.read_bytes()


def reads_infinity(path: Path) -> object:
    return {"strands": (np.ones(2), torch.tensor([0.0, np.inf]))}


@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (raises, "raised"),
        (says_two_lines, "refused"),
        (says_so_by_itself, "raised"),
        (reads, "read"),
        (reads_infinity, "not finite"),
    ],
    ids=["another error", "a line break", "two lines", "reading", "infinity"],
)
def test_outcomes_tell_faults(read: Callable[[Path], None], outcome: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    assert outcome_of(read, path)["outcome"] == outcome


@dataclass
class Nested:
    numbers: list[float]
    network: torch.nn.Module


def test_numbers_that_are_not_finite_are_found_wherever_they_are() -> None:
    network = torch.nn.Linear(2, 2)
    value = {"a": (np.arange(3), None, "nan"), "b": [Nested([1.0, 2.0], network)]}
    assert not_finite(value) == ""
    with torch.no_grad():
        network.bias[1] = np.nan
    assert not_finite(value) == "b.0.network.bias"
    value["b"][0].numbers.append(-np.inf)
    assert not_finite(value) == "b.0.numbers.2"
    assert not_finite([np.float32([1, np.nan])]) == "0"
    around: list[object] = [1.0]
    around.append(around)
    assert not_finite(around) == ""


def test_folders_are_damaged_file_by_file() -> None:
    whole = {"settings.json": b'{"frames": 3}', "frames.f32": bytes(range(200))}
    assert unpacked(packed(whole)) == whole
    made = [unpacked(mutant(packed(whole), random.Random(index))) for index in range(200)]
    for name, content in whole.items():
        assert any(name not in files for files in made)
        assert len({files.get(name) for files in made}) > 10
        assert any(files.get(name) == content != files.get(other) for files in made for other in whole)
    assert any(files.get("settings.json") in (b"{}", b"[]") for files in made)


FAULTY_PROCESS = """
import json, os, sys, time
print("ready", flush=True)
for line in sys.stdin:
    for path in json.loads(line)[1]:
        content = open(path, "rb").read()
        if content == b"0":
            os.abort()
        if content == b"1":
            time.sleep(100)
        print(json.dumps({"outcome": "raised" if content == b"2" else "read", "said": "", "seconds": 0.0}), flush=True)
"""


def test_a_reader_that_ends_waits_or_raises_is_a_fault_and_the_next_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []
    start = reading.subprocess.Popen

    def faulty(command: list[str], **options: object) -> object:
        started.append(command)
        return start([command[0], "-c", FAULTY_PROCESS], **options)  # type: ignore[call-overload]

    monkeypatch.setattr(reading.subprocess, "Popen", faulty)
    monkeypatch.setattr(reading, "STALL_SECONDS", 1.0)
    monkeypatch.setattr(harness, "mutants", lambda name, count, seed: [b"%d" % index for index in range(count)])
    begin = time.monotonic()
    tally = fuzz(["hair"], 4, keep=tmp_path)["hair"]
    assert time.monotonic() - begin < 30
    assert dict(tally.outcomes) == {"ended": 1, "too long": 1, "raised": 1, "read": 1}
    assert [index for index, _ in tally.faults] == [0, 1, 2]
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"hair_0_{index}.hair" for index in range(3)]
    assert len(started) == 3
    assert fuzz(["usda"], 1)["usda"].faults == []  # the library may end its own process


SERVING = """
from pathlib import Path
from tests.fuzzing.serving import serve

def spins(path):
    while True:
        pass

serve({"spins": spins, "aborts": lambda path: __import__("os").abort(), "reads": Path.read_bytes})
"""


def test_a_reader_that_computes_too_long_or_aborts_is_ended_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = reading.subprocess.Popen
    started = []

    def serving(command: list[str], **options: object) -> object:
        started.append(command)
        return start([command[0], "-c", SERVING], **options)  # type: ignore[call-overload]

    monkeypatch.setattr(reading.subprocess, "Popen", serving)
    monkeypatch.setattr(reading, "SECONDS", 0.2)
    path = tmp_path / "file"
    path.touch()
    reader = ReaderProcess()
    try:
        for name, outcome in (("spins", "too long"), ("aborts", "ended"), ("reads", "read")):
            assert [found["outcome"] for found in reader.read(name, [path, path])] == [outcome, outcome]
    finally:
        reader.stop()
    assert len(started) == 1


def test_memory_is_limited(tmp_path: Path) -> None:
    """A file that claims more than the limit must be refused by its reader, not by the system."""
    reader = ReaderProcess()
    try:
        path = tmp_path / "hair.csv"
        path.write_text("0 " * 10)
        (found,) = reader.read("csv", [path])
        assert found["outcome"] == "read"
        assert reader._process is not None
        limits = Path(f"/proc/{reader._process.pid}/limits")
        if limits.exists():
            (line,) = (line for line in limits.read_text().splitlines() if line.startswith("Max address space"))
            assert "unlimited" not in line
            os.kill(reader._process.pid, 0)
    finally:
        reader.stop()
