"""`quaffure crowd`: tables, rows that fail, rows that are there already."""

from pathlib import Path

import pytest

from quaffure import InputError, load_motion
from quaffure.apps import character_table
from quaffure.apps.character_table import CharacterRow, drape_row, read_table
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.io import read_drape

HEADER = "groom,motion,frames,out,stiffness,seed,shape\n"


def table_of(folder: Path, *lines: str) -> Path:
    path = folder / "characters.csv"
    path.write_text(HEADER + "".join(f"{line}\n" for line in lines))
    return path


@pytest.mark.slow
def test_rows_are_draped_failures_named_and_finished_rows_left(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = [tmp_path / "made" / f"{name}.npz" for name in ("soft", "stiff", "lost")]
    table = table_of(
        tmp_path,
        f"bob,nod,0:2,{out[0]},0.3,1,1 0 0 0 0 0 0 0 0 0",
        f"bob,nod,0,{out[1]},,,",
        f"none.hair,nod,0,{out[2]},,,",
    )
    with pytest.raises(SystemExit) as stop:
        main(["crowd", str(table), "--workers", "1"])
    assert stop.value.code == 4
    lines = capfd.readouterr().out.splitlines()
    assert "3 rows, 0 of them finished before; 1 process" in lines
    assert [
        line for line in lines if line.startswith(f"{out[2]}: none.hair: expected") and "found no such file" in line
    ]
    assert [line for line in lines if line.startswith("written: 2")]
    drapes = [read_drape(path) for path in out[:2]]
    assert [len(drape) for drape in drapes] == [2, 1]
    assert drapes[0].body_shape[0] == 1
    assert not out[2].exists()
    written = out[0].stat().st_mtime_ns
    with pytest.raises(SystemExit):
        main(["crowd", str(table), "--workers", "1"])
    assert "2 of them finished before" in capfd.readouterr().out.replace("\n", " ")
    assert out[0].stat().st_mtime_ns == written


def test_an_output_that_is_a_groom_of_the_table_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    groom, table = tmp_path / "own.npz", tmp_path / "characters.csv"
    groom.write_bytes(b"hair")
    table.write_text(
        f"groom,motion,out\n{groom},nod,{groom}\n", encoding="utf-8-sig"
    )  # with the mark that Excel writes
    with pytest.raises(SystemExit) as stop:
        main(["crowd", str(table)])
    assert stop.value.code == 2
    assert f"{groom}: expected" in capfd.readouterr().err
    assert groom.read_bytes() == b"hair"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("groom,motion\nbob,nod\n", "columns groom, motion, out"),
        ("groom,motion,out,colour\nbob,nod,a.npz,red\n", "colour"),
        (HEADER, "1 to 1000000 rows, found none"),
        ("groom,motion,out\nbob,nod,a.npz\nbob,nod,a.npz\n", "a.npz' 2 times"),
        ("groom,groom,motion,out\nbob,bob,nod,a.npz\n", "columns groom"),
        ("groom,motion,out\nbob,nod\n", "line 2: expected .* found no out"),
        ("groom,motion,out\nbob,nod,a.npz,0:1\n", "line 2: expected .* more values"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path: Path, text: str, found: str) -> None:
    path = tmp_path / "characters.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=found):
        read_table(path)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ({"shape": "1 2"}, "10 coefficients, found 2"),
        ({"shape": "nan" + 9 * " 0"}, "a number, found 'nan'"),
        ({"stiffness": "-1"}, "factors above 0"),
        ({"seed": "1.5"}, "a whole number"),
        ({"seed": "1e300"}, "a whole number"),
        ({"frames": "9:3"}, "0 <= A < B"),
        ({"motion": "none"}, "neither"),
    ],
)
def test_rows_that_cannot_be_draped_are_refused(tmp_path: Path, values: dict[str, str], found: str) -> None:
    fields = {"groom": "bob", "motion": "nod", "out": str(tmp_path / "a.npz"), "frames": "0"} | values
    with pytest.raises(InputError, match=found):
        drape_row(CharacterRow(**fields), "neural")
    assert not (tmp_path / "a.npz").exists()


@pytest.mark.parametrize(("motion", "expected"), [("nod", ""), ("character.glb#Run", "character.glb#Run")])
def test_rows_are_written_in_their_own_animation(
    motion: str, expected: str, body: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the file's skin moves the roots."""
    written: list[str] = []
    for name in ("_groom", "_draper", "drape_clip"):
        monkeypatch.setattr(character_table, name, lambda *args: None)
    monkeypatch.setattr(character_table, "_motion", lambda *args: load_motion("nod", body))
    monkeypatch.setattr(character_table, "save_drape", lambda drape, path, *, body, motion: written.append(motion))
    drape_row(CharacterRow("bob", motion, str(tmp_path / "a.usd")), "neural")
    assert written == [expected]
