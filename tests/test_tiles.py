"""What the figures of the docs are put together from: scripts/figures/tiles.py."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from quaffure import InputError
from quaffure.benchmark import CaseEntry
from quaffure.body import load_body
from quaffure.scene import BodyBatch
from scripts.figures.tiles import GAP, LINE, Caption, View, captioned, grid, load_scenes, save_picture

BLACK = np.zeros((20, 60, 3), np.uint8)
NOISE = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)


def test_captions_stand_below_the_tile() -> None:
    tile = captioned(BLACK, Caption("posed", ("5 %",)))
    assert tile.shape == (20 + 2 * LINE + GAP, 60, 3)
    assert not tile[:20].any()
    title, note = tile[20 + GAP // 2 :][:LINE], tile[20 + GAP // 2 + LINE :][:LINE]
    assert title.min() < note.min() < 200


def test_captions_that_would_be_cut_off_are_refused() -> None:
    with pytest.raises(InputError, match="long_straight"):
        captioned(BLACK, Caption("", ("long_straight on a walk",)))


def test_tiles_stand_in_rows_with_paper_between_them() -> None:
    white = np.full_like(BLACK, 255)
    sheet = grid([[BLACK, white], [white]])
    assert sheet.shape == (GAP + 2 * (20 + GAP), GAP + 2 * (60 + GAP), 3)
    assert not sheet[GAP : GAP + 20, GAP : GAP + 60].any()
    assert (sheet[GAP : GAP + 20, 60 + 2 * GAP : -GAP] == 255).all()
    paper = sheet[20 + 2 * GAP :, 60 + 2 * GAP :]
    assert (paper == paper[0, 0]).all()
    with pytest.raises(InputError, match="one size"):
        grid([[BLACK, white[:10]]])


def test_a_picture_is_as_good_as_its_weight_allows(tmp_path: Path) -> None:
    sizes = []
    for most in (20_000, 3_000):
        save_picture(tmp_path / "noise.jpg", NOISE, most)
        sizes.append((tmp_path / "noise.jpg").stat().st_size)
        with Image.open(tmp_path / "noise.jpg") as picture:
            assert picture.size == (64, 64)
    assert sizes[1] <= 3_000 < sizes[0]
    with pytest.raises(InputError, match="at most 100 bytes"):
        save_picture(tmp_path / "light.jpg", NOISE, 100)
    assert not (tmp_path / "light.jpg").exists()


def test_views_follow_the_chest_and_not_the_head() -> None:
    body = load_body()
    pose = torch.zeros(3, 27, 3)
    pose[1, body.joint_names.index("Head"), 2] = 1.0
    pose[2, body.joint_names.index("Spine1"), 2] = 0.5
    bodies = BodyBatch(body, pose.flatten(1), torch.zeros(3, 10))
    straight, head, chest = (np.subtract(c.eye, c.target) for c in (View(0.0).camera(bodies, i) for i in range(3)))
    np.testing.assert_allclose(head, straight, atol=1e-6)
    angles = [np.arctan2(x, -y) for x, y, _ in (straight, chest)]
    assert angles[1] - angles[0] == pytest.approx(0.5, abs=1e-4)  # to the body's left, as the chest


def test_a_clip_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"13_26\.bvh"):
        next(load_scenes([CaseEntry("bob", "13_26", "a", (0,))], tmp_path, load_body()))
