"""`quaffure crowd`: tables, rows that fail, rows that are there already."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from quaffure import InputError, load_motion
from quaffure.apps import character_table
from quaffure.apps.character_table import CharacterRow, drape_row, read_table
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.io import read_drape
from quaffure.procedural import make_groom

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


def test_rows_take_motion_files(tmp_path: Path) -> None:
    pose = np.zeros((2, 81), np.float32)
    pose[1, 3 * 12] = 0.1
    np.savez(tmp_path / "moves.npz", body_pose=pose, fps=30.0)
    row = CharacterRow("crew_cut", str(tmp_path / "moves.npz"), str(tmp_path / "a.npz"))
    drape_row(row, "neural")
    assert len(read_drape(tmp_path / "a.npz")) == 2


def test_more_frames_than_a_format_takes_are_refused_before_the_drape(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draped: list[object] = []
    monkeypatch.setattr(character_table, "drape_clip", lambda *args: draped.append(args))
    with pytest.raises(InputError, match=r"a\.hair: expected .*one frame"):
        drape_row(CharacterRow("bob", "nod", str(tmp_path / "a.hair"), "0:2"), "neural")
    assert not draped


def test_a_seed_makes_other_strands_on_a_body_of_the_table_too(
    body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(character_table, "_body", lambda path: body)
    found = [character_table._groom.__wrapped__("crew_cut", seed, "own.npz").rest_strands for seed in (0, 1)]
    assert torch.equal(found[1], make_groom("crew_cut", body, 1).rest_strands)
    assert found[0].shape != found[1].shape or not torch.equal(*found)


@pytest.mark.parametrize(
    ("motion", "of_body", "expected"),
    [("nod", "own.npz", ""), ("character.glb#Run", "own.npz", "character.glb#Run"), ("walk.bvh", "", "")],
)
def test_rows_are_written_in_their_own_animation(
    motion: str, of_body: str, expected: str, body: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the file's skin moves the roots; the shipped body has no file."""
    written: list[str] = []
    for name in ("_groom", "_draper", "drape_clip"):
        monkeypatch.setattr(character_table, name, lambda *args: None)
    origin = object() if of_body else None
    monkeypatch.setattr(character_table, "_body", lambda path: SimpleNamespace(origin=origin))
    monkeypatch.setattr(character_table, "_motion", lambda *args: load_motion("nod", body))
    monkeypatch.setattr(character_table, "save_drape", lambda drape, path, *, body, motion: written.append(motion))
    drape_row(CharacterRow("bob", motion, str(tmp_path / "a.usd"), body=of_body), "neural")
    assert written == [expected]
