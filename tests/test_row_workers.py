"""Rows on several processes, here and in a Ray cluster: tries, rows in flight, processes that end."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from quaffure.apps.character_table import CharacterRow
from quaffure.apps.row_workers import Outcome, drape_rows
from quaffure.extras import is_installed
from quaffure.io import read_drape

ROOT = Path(__file__).parents[1]
FINAL, OTHER = Outcome("a file, none", is_final=True), Outcome("RuntimeError: no memory")


def rows_named(*names: str) -> list[CharacterRow]:
    return [CharacterRow("bob", "nod", name) for name in names]


class Threads:
    """Workers that do what the name of a row says, on its first, second, ... try."""

    in_flight = 3

    def __init__(self, tries: dict[str, list[Outcome | Exception]]) -> None:
        self.tries, self.submitted, self.most, self._running = tries, list[str](), 0, 0
        self._pool = ThreadPoolExecutor(4)

    def submit(self, row: CharacterRow, draper: str) -> "Future[Outcome]":
        self.submitted.append(row.out)
        self._running += 1
        self.most = max(self.most, self._running)
        return self._pool.submit(self._try, row)

    def _try(self, row: CharacterRow) -> Outcome:
        time.sleep(0.01)
        self._running -= 1
        outcomes = self.tries.get(row.out, [])
        outcome = outcomes.pop(0) if outcomes else Outcome()
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def close(self) -> None:
        self._pool.shutdown()


def errors_of(workers: Threads, rows: Sequence[CharacterRow], retries: int) -> dict[str, str]:
    return {finished.row.out: finished.error for finished in drape_rows(rows, "neural", workers, retries)}


def test_a_row_is_tried_again_unless_its_input_is_at_fault() -> None:
    workers = Threads({"once": [OTHER], "lost": [FINAL], "broken": [OTHER] * 9, "ended": [RuntimeError("x\nkilled")]})
    found = errors_of(workers, rows_named("fine", "once", "lost", "broken", "ended"), retries=2)
    assert found == {"fine": "", "once": "", "lost": FINAL.error, "broken": OTHER.error, "ended": ""}
    assert {name: workers.submitted.count(name) for name in found} == {
        "fine": 1, "once": 2, "lost": 1, "broken": 3, "ended": 2,
    }  # fmt: skip
    assert "killed" in errors_of(Threads({"a": [RuntimeError("x\nkilled")]}), rows_named("a"), retries=0)["a"]


def test_every_row_is_draped_once_and_few_are_in_flight() -> None:
    workers, names = Threads({}), [f"row {index}" for index in range(40)]
    assert [*errors_of(workers, rows_named(*names), retries=1)] != []
    assert sorted(workers.submitted) == sorted(names)
    assert workers.most == workers.in_flight


def test_rows_whose_process_ended_are_tried_again_one_by_one() -> None:
    names = [f"row {index}" for index in range(6)]
    workers = Threads({name: [RuntimeError()] for name in names})
    assert set(errors_of(workers, rows_named(*names), retries=0).values()) != {""}
    workers = Threads({name: [RuntimeError()] for name in names})
    found = drape_rows(rows_named(*names), "neural", workers, retries=1)
    assert next(found).error == ""
    workers.most = 0
    assert [finished.error for finished in found] == [""] * 5
    assert workers.most == 1


@pytest.mark.slow
def test_a_process_that_ends_takes_no_other_row_with_it(tiny_groom_file: Path, tmp_path: Path) -> None:
    """The groom of one row ends its process, each time it is read."""
    groom = tmp_path / "fatal.usda"
    out = [tmp_path / f"{index}.npz" for index in range(4)]
    rows = [CharacterRow(str(tiny_groom_file), "nod", str(path), "0") for path in out]
    rows[1] = CharacterRow(str(groom), "nod", str(out[1]), "0")
    groom.write_text("ends")
    patch = (
        "import os\n"
        "from quaffure.apps import character_table\n"
        "load = character_table.load_groom\n"
        "character_table.load_groom = lambda name, body: os.abort() if 'fatal' in str(name) else load(name, body)\n"
    )
    (tmp_path / "sitecustomize.py").write_text(patch)
    program = (
        "from quaffure.apps.row_workers import *\n"
        "from quaffure.apps.character_table import CharacterRow\n"
        "if __name__ == '__main__':\n"
        "    import json, sys\n"
        "    rows = [CharacterRow(*row) for row in json.loads(sys.argv[1])]\n"
        "    workers = LocalProcesses(2)\n"
        "    print(json.dumps({one.row.out: one.error for one in drape_rows(rows, 'neural', workers)}))\n"
        "    workers.close()\n"
    )
    (tmp_path / "program.py").write_text(program)
    arguments = json.dumps([[row.groom, row.motion, row.out, row.frames] for row in rows])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, str(tmp_path / "program.py"), arguments]
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert "ended" in found.pop(str(out[1]))
    assert set(found.values()) == {""}
    assert [path.exists() for path in out] == [True, False, True, True]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """Address of a cluster of two local workers, of one processor each."""
    if not is_installed("ray"):
        pytest.skip("no ray")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        made.add_node(num_cpus=1)
        yield made.address
    finally:
        made.shutdown()


@pytest.mark.slow
def test_a_ray_cluster_drapes_a_table_and_continues_it(
    cluster: str, tmp_path: Path, crowd: Callable[..., "subprocess.CompletedProcess[str]"]
) -> None:
    table = tmp_path / "characters.csv"
    lines = [f"bob,nod,{index},{index}.npz" for index in range(3)]
    table.write_text("\n".join(["groom,motion,frames,out", *lines, "none.hair,nod,0,lost.npz", ""]))
    run = crowd(str(table), "--ray", cluster)
    assert run.returncode == 4, run.stderr
    said = run.stdout.replace("\n", " ")
    assert "a Ray cluster of 2 processors" in said
    assert "none.hair: expected" in said
    assert "written: 3" in said
    assert [len(read_drape(tmp_path / f"{index}.npz")) for index in range(3)] == [1, 1, 1]
    (tmp_path / "1.npz").unlink()
    written = (tmp_path / "0.npz").stat().st_mtime_ns
    run = crowd(str(table), "--ray", cluster)
    assert "2 of them finished before" in run.stdout.replace("\n", " ")
    assert (tmp_path / "1.npz").exists()
    assert (tmp_path / "0.npz").stat().st_mtime_ns == written


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_refused(
    tmp_path: Path, crowd: Callable[..., "subprocess.CompletedProcess[str]"]
) -> None:
    table = tmp_path / "characters.csv"
    table.write_text("groom,motion,out\nbob,nod,a.npz\n")
    run = crowd(str(table), "--ray", "127.0.0.1:1")
    assert run.returncode == 2, run.stderr
    assert run.stderr.startswith("quaffure: --ray: expected ")
    assert run.stderr.count("\n") == 1


@pytest.fixture
def crowd(tmp_path: Path) -> Callable[..., "subprocess.CompletedProcess[str]"]:
    """The command, run in a folder of its own."""

    def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "quaffure", "crowd", *arguments]
        paths = os.pathsep.join([str(ROOT / "src"), *filter(None, sys.path)])
        environment = os.environ | {"PYTHONPATH": paths, "COLUMNS": "200", "RAY_USAGE_STATS_ENABLED": "0"}
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)

    return run
