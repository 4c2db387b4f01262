import json
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from quaffure.cli import grooms as command
from quaffure.cli.main import main
from quaffure.groom.hair_style import HELD_OUT, STYLES
from quaffure.render import contact_sheet


@pytest.fixture(autouse=True)
def three_small_styles(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: replace(STYLES[name], root_rows=16) for name in ("bob", "mullet", "ponytail")}
    monkeypatch.setattr(command, "STYLES", few)
    monkeypatch.setattr("quaffure.groom.procedural.STYLES", few)
    monkeypatch.setattr(contact_sheet, "DRAWN_STRANDS", 300)
    monkeypatch.setattr(contact_sheet, "SUPERSAMPLING", 1)


def test_the_sheet_is_written_beside_the_list(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "grooms.png"
    main(["grooms", "--json", "--out", str(out)])
    rows = json.loads(capfd.readouterr().out)
    assert [row["name"] for row in rows] == ["bob", "mullet", "ponytail"]
    assert [row["held_out"] for row in rows] == [row["name"] in HELD_OUT for row in rows]
    with Image.open(out) as sheet:
        assert sheet.format == "PNG"


@pytest.mark.parametrize(("name", "expected"), [("grooms.jpg", "ending in .png"), ("missing/grooms.png", "no folder")])
def test_a_bad_out_costs_no_growing(
    name: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "make_groom", None)
    with pytest.raises(SystemExit) as stop:
        main(["grooms", "--out", str(tmp_path / name)])
    assert stop.value.code == 2
    assert expected in " ".join(capfd.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []
