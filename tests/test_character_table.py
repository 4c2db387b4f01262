"""`quaffure crowd`: rows on several processes, rows that fail, rows that are there already."""

from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from unittest import mock

import pytest

from quaffure.apps.character_table import CharacterRow, drape_rows, read_table
from quaffure.apps.cli.main import main
from quaffure.errors import InputError
from quaffure.io import read_drape

HEADER = "groom,motion,frames,out,stiffness,seed,shape\n"


def table_of(folder: Path, *lines: str) -> Path:
    path = folder / "characters.csv"
    path.write_text(HEADER + "".join(f"{line}\n" for line in lines))
    return path


def test_rows_are_draped_failures_named_and_finished_rows_left(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = [tmp_path / f"{name}.npz" for name in ("soft", "stiff", "lost")]
    table = table_of(
        tmp_path,
        f"bob,nod,0:2,{out[0]},0.3,1,1 0 0 0 0 0 0 0 0 0",
        f"bob,nod,0,{out[1]},,,",
        f"none.hair,nod,0,{out[2]},,,",
    )
    with pytest.raises(SystemExit) as stop:
        main(["crowd", str(table), "--workers", "1"])
    assert stop.value.code == 4
    said = capfd.readouterr().out.replace("\n", " ")
    assert "3 rows, 0 of them finished before" in said
    assert "none.hair: expected" in said
    assert "written: 2" in said
    drapes = [read_drape(path) for path in out[:2]]
    assert [len(drape) for drape in drapes] == [2, 1]
    assert drapes[0].body_shape[0] == 1
    assert not out[2].exists()
    written = out[0].stat().st_mtime_ns
    with pytest.raises(SystemExit):
        main(["crowd", str(table), "--workers", "1"])
    assert "2 of them finished before" in capfd.readouterr().out.replace("\n", " ")
    assert out[0].stat().st_mtime_ns == written


def test_a_row_is_tried_again_unless_its_input_is_at_fault() -> None:
    rows = [CharacterRow("bob", "nod", name) for name in ("fine", "ended", "lost", "broken")]
    tries: list[str] = []

    def drape_row(row: CharacterRow, draper: str) -> None:
        tries.append(row.out)
        if row.out == "ended" and tries.count("ended") == 1:
            raise BrokenProcessPool
        if row.out == "lost":
            raise InputError("lost", "a file", "none")
        if row.out == "broken":
            raise RuntimeError("no memory")

    with (
        mock.patch("quaffure.apps.character_table.drape_row", drape_row),
        mock.patch("quaffure.apps.character_table._pool", lambda workers: ThreadPoolExecutor(workers)),
    ):
        found = {finished.row.out: finished.error for finished in drape_rows(rows, "neural", 2, retries=2)}
    assert found == {
        "fine": "",
        "ended": "",
        "lost": "lost: expected a file, found none",
        "broken": "RuntimeError: no memory",
    }
    assert {name: tries.count(name) for name in found} == {"fine": 1, "ended": 2, "lost": 1, "broken": 3}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("groom,motion\nbob,nod\n", "columns groom, motion, out"),
        ("groom,motion,out,colour\nbob,nod,a.npz,red\n", "colour"),
        (HEADER, "at least one row"),
        ("groom,motion,out\nbob,nod,a.npz\nbob,nod,a.npz\n", "a.npz twice"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path: Path, text: str, found: str) -> None:
    path = tmp_path / "characters.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=found):
        read_table(path)
