import json
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from quaffure.apps.cli import groom as command
from quaffure.apps.cli.main import main
from quaffure.apps.render import contact_sheet
from quaffure.body import BodyModel
from quaffure.procedural import HELD_OUT, STYLES, make_groom
from quaffure.procedural.hair_style import style_sizes


@pytest.fixture(autouse=True)
def three_small_styles(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: replace(STYLES[name], root_rows=16) for name in ("bob", "mullet", "ponytail")}
    monkeypatch.setattr(command, "STYLES", few)
    monkeypatch.setattr("quaffure.procedural.generator.STYLES", few)
    monkeypatch.setattr(contact_sheet, "SHOWN_STRANDS", 300)
    monkeypatch.setattr(contact_sheet, "SUPERSAMPLING", 1)


def test_the_sheet_is_written_next_to_the_list(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "grooms.png"
    main(["grooms", "--json", "--out", str(out)])
    rows = json.loads(capfd.readouterr().out)
    assert {"bob", "mullet", "ponytail"} < {row["name"] for row in rows}
    assert [row["held_out"] for row in rows] == [row["name"] in HELD_OUT for row in rows]
    with Image.open(out) as sheet:
        assert sheet.format == "PNG"


def test_the_list_is_that_of_the_styles(body: BodyModel) -> None:
    assert list(style_sizes()) == list(STYLES)
    groom = make_groom(STYLES["pixie"], body)
    length = round(float(groom.strand_lengths.mean()), 3)
    assert style_sizes()["pixie"] == {"strands": len(groom), "length_m": length}


@pytest.mark.parametrize(("name", "expected"), [("grooms.jpg", "suffix .png"), ("missing/grooms.png", "no folder")])
def test_a_bad_out_is_refused_before_the_work(
    name: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "make_groom", None)
    with pytest.raises(SystemExit) as stop:
        main(["grooms", "--out", str(tmp_path / name)])
    assert stop.value.code == 2
    assert expected in " ".join(capfd.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []
