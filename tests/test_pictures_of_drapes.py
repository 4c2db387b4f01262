"""What commands print while they draw a drape, and what pictures of sparse grooms show."""

import inspect
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

import quaffure
from quaffure import load_motion
from quaffure.apps.cli.main import main
from quaffure.apps.cli.outputs import writing_text
from quaffure.apps.render.framing import frames_of_picture
from quaffure.body import CLIP_NAMES
from quaffure.hair import ExportClip
from quaffure.io import read_drape, write_drape, write_groom
from quaffure.io.read_strands import read_strands
from quaffure.procedural import STYLES, make_groom
from tests.synthetic_drape import drape, patch_of_strands

pytestmark = pytest.mark.usefixtures("small_pictures")


def printed(capfd: pytest.CaptureFixture[str], *words: str | Path) -> list[str]:
    main([*map(str, words)])
    return capfd.readouterr().out.splitlines()


@pytest.mark.parametrize(
    ("count", "frames", "text"),
    [
        (1, [0], "the only frame"),
        (2, [0, 1], "frames 0 and 1 of the drape's 2"),
        (5, [0, 1, 3, 4], "frames 0, 1, 3 and 4 of the drape's 5"),
        (91, [0, 30, 60, 90], "frames 0, 30, 60 and 90 of the drape's 91"),
    ],
)
def test_a_picture_names_its_frames(count: int, frames: list[int], text: str) -> None:
    assert frames_of_picture(count) == frames
    assert writing_text(Path("a/hair.png"), count) == f"writing a/hair.png: {text}, from 4 sides"
    assert writing_text(Path("a/hair.mp4"), count) == "writing a/hair.mp4"


def test_pictures_and_videos_show_how_far_they_are(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_drape(tmp_path / "drape.npz", drape(patch_of_strands((0.0, 0.0, 1.0)), frames=5))
    lines = printed(
        capfd, "render", tmp_path / "drape.npz", "--out", tmp_path / "hair.png", "--out", tmp_path / "hair.mp4"
    )
    assert f"writing {tmp_path}/hair.png: frames 0, 1, 3 and 4 of the drape's 5, from 4 sides" in lines
    assert f"writing {tmp_path}/hair.mp4" in lines
    progress = [line for line in lines if " left: writing " in line]
    assert re.fullmatch(r"1 of 16, \d+:\d\d:\d\d left: writing hair.png", progress[0])
    assert any(re.fullmatch(r"1 of 5, \d+:\d\d:\d\d left: writing hair.mp4", line) for line in progress)
    for command in ("drape", "render"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        said = " ".join(capfd.readouterr().out.replace("│", " ").split())
        assert ".png (up to four frames, evenly spaced from the first to the last, each from four sides)" in said


@pytest.fixture
def sparse(tmp_path: Path, body) -> Path:
    write_groom(tmp_path / "sparse.npz", make_groom(STYLES["bob"], body).thinned(200))
    return tmp_path / "sparse.npz"


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


@pytest.mark.slow
def test_the_first_picture_of_a_sparse_groom_has_a_full_head_of_hair(
    tmp_path: Path, sparse: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    drape_file, first, guides, drawn, usd = (tmp_path / name for name in ("d.npz", "a.png", "b.png", "c.png", "d.usd"))
    words = ("drape", sparse, "--draper", "posed", "--frames", "0", "--out", drape_file, "--out", first, "--out", usd)
    lines = printed(capfd, *words)
    (hint,) = [line for line in lines if line.startswith("pictures show 12000 strands between the 200 draped ones")]
    assert "--strands guides" in hint
    assert any(line.startswith("warning: 200 guides are few: ") for line in lines)
    assert len(read_strands(usd).counts) == 200
    lines = printed(capfd, "render", drape_file, "--out", drawn)
    assert hint in lines
    assert np.abs(pixels(drawn) - pixels(first)).mean() < 0.5
    lines = printed(capfd, "render", drape_file, "--strands", "guides", "--out", guides)
    assert not [line for line in lines if line.startswith("pictures show")]
    assert np.abs(pixels(guides) - pixels(first)).mean() > 2
    lines = printed(capfd, "render", drape_file, "--out", tmp_path / "e.usd")
    assert not [line for line in lines if line.startswith("pictures show")]


@pytest.mark.slow
def test_strands_between_are_part_of_the_time_of_pictures(
    tmp_path: Path, sparse: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that stands still but for them."""
    seconds = [0.0]

    def slow(clip: ExportClip, *_: object) -> ExportClip:
        seconds[0] += 1e6
        return clip

    monkeypatch.setattr("quaffure.apps.cli.drape.clip_of_pictures", slow)
    monkeypatch.setattr("quaffure.apps.cli.drape_report.time", SimpleNamespace(perf_counter=lambda: seconds[0]))
    outputs = [word for name in ("d.npz", "a.png", "b.png") for word in ("--out", str(tmp_path / name))]
    main(["drape", str(sparse), "--draper", "posed", "--frames", "0", "--json", *outputs])
    laps = json.loads(capfd.readouterr().out)["seconds"]
    assert laps["pictures"] > 0.9e6
    assert laps["files"] == 0


@pytest.mark.slow
def test_pictures_and_videos_are_filled(tmp_path: Path, body, capfd: pytest.CaptureFixture[str]) -> None:
    groom = make_groom(STYLES["bob"], body).thinned(1600)
    write_groom(tmp_path / "groom.npz", groom)
    outputs = "--out", tmp_path / "a.png", "--out", tmp_path / "a.mp4", "--out", tmp_path / "a.npz"
    lines = printed(capfd, "drape", tmp_path / "groom.npz", "--draper", "posed", "--frames", "0:2", *outputs)
    for shown in ("pictures show 12000", "videos show 6000"):
        assert [line for line in lines if line.startswith(f"{shown} strands between the {len(groom)} draped ones")]
    assert not [line for line in lines if line.startswith("warning")]
    filled = quaffure.draw(read_drape(tmp_path / "a.npz"), size=64)
    quaffure.save_drape(read_drape(tmp_path / "a.npz"), tmp_path / "b.png")
    assert np.abs(np.asarray(filled).astype(int) - pixels(tmp_path / "b.png")[:64, :64]).mean() < 0.5


def test_large_files_are_named_with_their_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    write_drape(tmp_path / "drape.npz", drape(patch_of_strands((0.0, 0.0, 1.0)), frames=5))
    monkeypatch.setattr("quaffure.apps.cli.outputs.LARGE_BYTES", 1000)
    lines = printed(capfd, "render", tmp_path / "drape.npz", "--out", tmp_path / "a.glb")
    size = (tmp_path / "a.glb").stat().st_size / 1e6
    assert f"written: {tmp_path}/a.glb ({size:.0f} MB)" in lines


def test_help_names_the_bundled_clips_with_their_lengths(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["drape", "--help"])
    said = " ".join(capfd.readouterr().out.replace("│", " ").split())
    for clip in CLIP_NAMES:
        assert clip in said
        motion = load_motion(clip)
        assert re.search(rf"\b{clip}\b[^()]*\({len(motion) / motion.fps:g} s", said)
    assert "{None}" not in said


def test_what_is_no_drape_is_named_with_what_makes_one(tmp_path: Path) -> None:
    hair = torch.zeros(1, 5, 24, 3)
    for use, more in ((quaffure.draw, ()), (quaffure.save_drape, (tmp_path / "a.png",))):
        with pytest.raises(quaffure.InputError, match=r"drape_clip.*found a Tensor"):
            inspect.unwrap(use)(hair, *more)


def test_a_drape_on_another_body_names_its_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    other = drape(patch_of_strands((0.0, 0.0, 1.0)), frames=1)
    write_drape(tmp_path / "other.npz", replace(other, meta={"body": "anna.npz"}))
    lines = printed(capfd, "render", tmp_path / "other.npz", "--out", tmp_path / "other.png")
    cure = f"{tmp_path}/other.npz: expected a drape on the shipped body, found another body"
    assert [line for line in lines if cure in line and line.endswith("--body anna.npz")]
    with pytest.raises(SystemExit):
        main(["render", str(tmp_path / "other.npz"), "--strands", "50", "--out", str(tmp_path / "other.png")])
    assert cure in capfd.readouterr().err


def test_two_strands_are_drawn_as_they_are(tmp_path: Path, body, capfd: pytest.CaptureFixture[str]) -> None:
    write_groom(tmp_path / "two.npz", make_groom(STYLES["bob"], body).thinned(2))
    words = ("drape", tmp_path / "two.npz", "--draper", "posed", "--frames", "0", "--out", tmp_path / "two.png")
    assert not [line for line in printed(capfd, *words) if line.startswith("pictures show")]
    assert (tmp_path / "two.png").is_file()
