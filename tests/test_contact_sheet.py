from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from quaffure import InputError
from quaffure.apps.render import contact_sheet, write_contact_sheet
from quaffure.body import BodyModel, load_body
from quaffure.hair import Groom
from quaffure.procedural import STYLES, make_groom


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def grooms(body: BodyModel) -> list[Groom]:
    names = ("bob", "crew_cut")
    return [replace(make_groom(replace(STYLES[name], root_rows=20), body), name=name) for name in names]


@pytest.fixture(autouse=True)
def few_strands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_sheet, "SHOWN_STRANDS", 600)
    monkeypatch.setattr(contact_sheet, "SUPERSAMPLING", 1)


def test_a_sheet_shows_every_groom_from_three_sides(tmp_path: Path, grooms: list[Groom], body: BodyModel) -> None:
    path, done = tmp_path / "grooms.png", []
    write_contact_sheet(path, grooms, body, {"bob": "a note"}, done.append)
    assert done == [1, 2]
    with Image.open(path) as picture:
        sheet = np.asarray(picture).astype(int)
    assert sheet.shape[1] <= 2440
    gap, width, height = contact_sheet.GAP, contact_sheet.TILE_WIDTH, contact_sheet.TILE_HEIGHT
    tiles = [
        sheet[gap : gap + height, left : left + width]
        for cell in range(2)
        for left in [gap + cell * (3 * width + gap) + view * width for view in range(3)]
    ]
    for tile in tiles:
        assert tile.std() > 20
    for first in range(6):
        for second in range(first):
            assert np.abs(tiles[first] - tiles[second]).mean() > 3
    # Names stand under the pictures; the third and fourth cells are paper.
    caption = sheet[gap + height : gap + height + contact_sheet.CAPTION]
    assert caption[:, gap : gap + 60].min() < 100
    assert (sheet[:, 2 * (3 * width + gap) + gap :] == contact_sheet.PAPER).all()


def test_other_formats_and_missing_folders_are_refused(tmp_path: Path, grooms: list[Groom], body: BodyModel) -> None:
    with pytest.raises(InputError, match=r"\.png"):
        write_contact_sheet(tmp_path / "grooms.jpg", grooms, body)
    with pytest.raises(InputError, match="no folder"):
        write_contact_sheet(tmp_path / "missing" / "grooms.png", grooms, body)
    assert list(tmp_path.iterdir()) == []
