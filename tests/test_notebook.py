"""What notebooks show of grooms and drapes: a picture, or text where nothing can draw one."""

import base64
import io
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from quaffure import InputError, drape_clip, extras
from quaffure.apps.render import scene
from quaffure.baselines import PosedDraper
from quaffure.body import bundled_clip, load_body
from quaffure.hair import DrapeSequence, Groom
from quaffure.procedural import make_groom
from tests.synthetic_drape import drape, patch_of_strands


@pytest.fixture(scope="module")
def groom() -> Groom:
    whole = make_groom("bob", load_body())
    return whole.select(torch.arange(0, len(whole), 8))


@pytest.fixture(scope="module")
def sequence(groom: Groom) -> DrapeSequence:
    clip = bundled_clip("nod", load_body())
    return drape_clip(groom, clip.select(slice(0, 50, 10)), draper=PosedDraper())


def needs_opengl() -> None:
    try:
        scene.StrandRenderer(8, 8).release()
    except InputError as error:
        pytest.skip(f"no OpenGL here: {error}")


def pictured(html: str) -> np.ndarray:
    """Pixels of the picture in a piece of HTML."""
    (encoded,) = re.findall(r'<img src="data:image/jpeg;base64,([^"]+)">', html)
    return np.array(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB")).astype(int)


def hair_pixels(picture: np.ndarray) -> int:
    red, green, blue = np.moveaxis(picture, -1, 0)
    return int(((red > green) & (green > blue) & (red < 130) & (red > blue + 15)).sum())


def test_a_groom_is_drawn_from_three_sides(groom: Groom) -> None:
    needs_opengl()
    html = groom._repr_html_()
    picture = pictured(html)
    assert picture.shape == (256, 3 * 256, 3)
    assert all(hair_pixels(tile) > 2000 for tile in np.hsplit(picture, 3))
    assert f"<b>bob</b>: {len(groom)} strands of 24 vertices" in html


def test_a_drape_is_drawn_in_up_to_three_frames(sequence: DrapeSequence) -> None:
    needs_opengl()
    html = sequence._repr_html_()
    tiles = np.hsplit(pictured(html), 3)
    assert all(hair_pixels(tile) > 2000 for tile in tiles)
    assert np.abs(tiles[0] - tiles[1]).max() > 50  # the head nods
    assert "draped by posed" in html
    assert "5 frames at 30 a second" in html


def test_a_drape_of_another_body_is_drawn_without_strands_between_guides() -> None:
    needs_opengl()
    assert pictured(drape(patch_of_strands((0.0, 0.0, 1.0)), frames=1)._repr_html_()).shape == (256, 256, 3)


def test_a_groom_of_another_body_is_drawn_alone(groom: Groom) -> None:
    needs_opengl()
    moved = replace(groom, rest_strands=groom.rest_strands + torch.tensor([0.0, 0.0, 1.0]))
    other = replace(groom, root_faces=groom.root_faces + 10**6)
    for shown in (moved, other):
        assert hair_pixels(pictured(shown._repr_html_())) > 2000


def test_without_the_renderer_text_is_shown(
    groom: Groom, sequence: DrapeSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "is_installed", lambda module: module != "moderngl")
    for html in (groom._repr_html_(), sequence._repr_html_()):
        assert "<img" not in html
        assert "strands of 24 vertices" in html
        assert "pip install &#x27;quaffure[render]&#x27;" in html


def test_names_of_files_are_text(groom: Groom, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "is_installed", lambda module: False)
    html = replace(groom, name="<script>", licence="<img>")._repr_html_()
    assert "<script>" not in html
    assert "<img>" not in html
