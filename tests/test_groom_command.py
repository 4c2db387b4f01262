"""`quaffure groom`, `quaffure render` and `--strands`: what they write, and one line for every mistake."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import InputError, load_groom
from quaffure.apps.cli.main import main
from quaffure.apps.cli.outputs import check_outputs
from quaffure.apps.cli.style_settings import ABOVE_ZERO, with_settings
from quaffure.body import BodyModel, load_body
from quaffure.hair import RegistrationReport
from quaffure.io import load_source, read_groom, read_source, write_groom
from quaffure.io.read_strands import read_strands
from quaffure.procedural import STYLES, HairStyle, hair_style, make_groom
from tests.test_groom_files import hair_bytes, tfx4_bytes

FEW_ROOTS = "root_rows=14"


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def drape(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drape of few strands."""
    folder = tmp_path_factory.mktemp("drape")
    main(["groom", "new", "--style", "bob", "--set", FEW_ROOTS, "--out", str(folder / "bob.npz")])
    out = ["--out", str(folder / "drape.npz"), "--out", str(folder / "drape.usd")]
    main(["drape", str(folder / "bob.npz"), "--draper", "posed", "--frames", "0:2", "--strands", "700", *out])
    return folder / "drape.npz"


def refused(capfd: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    errors = capfd.readouterr().err
    assert stop.value.code == 2, errors
    assert errors.startswith("quaffure: ")
    assert errors.count("\n") == 1
    return errors


# --- new -------------------------------------------------------------------------------------------------------------


def test_new_grooms_take_their_controls(tmp_path: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine.npz"
    arguments = ["groom", "new", "--style", "bob", "--out", str(out), "--set", FEW_ROOTS, "length_variation=0"]
    main([*arguments, "--set", "length=0.1", "--set", "cut_height=none", "clumping=0"])
    assert "strands of" in capfd.readouterr().out
    groom = read_groom(out, body)
    assert groom.name == "mine"
    assert groom.licence
    assert 20 < len(groom) < 14**2
    assert 0.09 < float(groom.strand_lengths.mean()) < 0.105
    main([*arguments, "--seed", "5"])
    other = read_groom(out, body)
    assert other.root_uv.shape != groom.root_uv.shape or (other.root_uv - groom.root_uv).abs().max() > 1e-3


def test_settings_reach_every_kind_of_control() -> None:
    style = HairStyle()
    assert with_settings(style, ("length=0.25",)).length == 0.25
    assert with_settings(style, ("parting=none",)).parting is None
    assert with_settings(style, ("parting=-0.02",)).parting == -0.02
    assert with_settings(style, ("root_rows=20",)).root_rows == 20
    assert with_settings(style, ("length_map=1,0.5,0.25,2",)).length_map == (1, 0.5, 0.25, 2)
    assert with_settings(style, ("cut_around_ears=true",)).cut_around_ears
    fringed = with_settings(style, ("fringe.sweep=0.5", "fringe.depth=0.04")).fringe
    assert fringed == hair_style.Fringe(sweep=0.5, depth=0.04)
    tied = with_settings(STYLES["ponytail"], ("ties.0.radius=0.02",))
    assert tied.ties[0].radius == 0.02
    assert with_settings(tied, ("ties=none",)).ties == ()
    assert with_settings(style, ()) == style


def test_controls_that_must_be_positive_exist() -> None:
    parts = (HairStyle, hair_style.Fringe, hair_style.Clipping, hair_style.Tie)
    assert set(ABOVE_ZERO) <= {field.name for part in parts for field in fields(part)}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("length", "expected control=value"),
        ("lenght=1", "expected one of the controls length, "),
        ("length=long", "expected a number, found 'long'"),
        ("length=-1", "expected above 0"),
        ("length=nan", "expected above 0"),
        ("frizz=inf", "expected within +-100"),
        ("clump_spacing=0", "expected above 0"),
        ("root_rows=65", "expected at most 64"),
        ("length=50", "expected at most 2 m"),
        ("root_rows=2.5", "expected a whole number"),
        ("length_map=1,1", "expected 4 numbers separated by commas, found 2"),
        ("length=none", "expected a number"),
        ("cut_around_ears=1", "expected true or false"),
        ("length.of=1", "expected a part of this style"),
        ("fringe=1", "expected fringe.CONTROL=value, or none"),
        ("fringe.wave=1", "expected one of the controls cut_height, "),
        ("ties.0.radius=0.01", "expected a part of this style"),
    ],
)
def test_bad_settings_are_named(setting: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        with_settings(HairStyle(), (setting,))
    assert str(caught.value).startswith(f"--set {setting}: ")
    assert message in str(caught.value)


def test_bad_new_grooms(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    new = ("groom", "new", "--out")
    assert "mine.hair: expected an output of suffix .npz" in refused(capfd, *new, tmp_path / "mine.hair")
    assert "found no folder" in refused(capfd, *new, tmp_path / "absent" / "mine.npz")
    line = refused(capfd, *new, tmp_path / "mine.npz", "--style", "beehive")
    assert "--style: expected one of " in line
    assert "bob" in line
    assert "--seed: expected" in refused(capfd, *new, tmp_path / "mine.npz", "--seed=-1")
    assert "--set lengths=1: " in refused(capfd, *new, tmp_path / "mine.npz", "--set", "lengths=1")
    assert not list(tmp_path.iterdir())


def test_new_grooms_of_no_strands_and_of_strands_without_a_length_are_refused(
    tmp_path: Path, body: BodyModel, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    groom = make_groom(with_settings(STYLES["bob"], (FEW_ROOTS,)), body)
    without = groom.rest_strands.clone()
    without[3, 7] = without[3, 6]
    for made, expected in (
        (groom.select(torch.arange(0)), "--set: expected controls that make hair, found no strands"),
        (replace(groom, rest_strands=without), "--set: expected edges longer than 1e-06 m and strands under"),
    ):
        monkeypatch.setattr("quaffure.apps.cli.groom.make_groom", lambda *_, made=made: made)
        assert expected in refused(capfd, "groom", "new", "--out", tmp_path / "mine.npz")


# --- import ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory, body: BodyModel) -> Path:
    """A bundled groom in centimetres with y up, in two files."""
    folder = tmp_path_factory.mktemp("foreign")
    rest = make_groom(with_settings(STYLES["bob"], ("root_rows=24",)), body).rest_strands.numpy()
    turned = 100 * np.stack([rest[..., 0], rest[..., 2], -rest[..., 1]], -1)[:, ::3]
    for name, part in (("a", turned[::2]), ("b", turned[1::2])):
        np.savez(folder / f"{name}.npz", strands=part.astype(np.float32))
    return folder


@pytest.mark.usefixtures("small_pictures")
def test_import_registers_and_shows(
    tmp_path: Path, foreign: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]
) -> None:
    out, picture = tmp_path / "theirs.npz", tmp_path / "theirs.png"
    files = [str(foreign / "a.npz"), str(foreign / "b.npz")]
    main(["groom", "import", *files, "--out", str(out), "--picture", str(picture), "--licence", "CC-BY 4.0"])
    message = " ".join(capfd.readouterr().out.split())
    assert "read in cm with +y up" in message
    assert "mm from the scalp in the median" in message
    groom = read_groom(out, body)
    assert (groom.name, groom.licence) == ("theirs", "CC-BY 4.0")
    assert len(groom) > 300
    from PIL import Image

    with Image.open(picture) as image:
        pixels = np.asarray(image).astype(int)
    assert pixels.shape == (192, 128, 3)
    brown = pixels[..., 0] - pixels[..., 2] > 25
    before, after = brown[:, :64].mean(), brown[:, 64:].mean()
    assert 0.02 < before < after  # no body on the left


@pytest.mark.slow
def test_reports_say_which_strands_are_used_and_why_not_the_others(
    tmp_path: Path, foreign: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """`groom import` and `drape` print the same about a strand file."""
    strands = np.load(foreign / "a.npz")["strands"]
    few = strands[::2].copy()
    few[:7] += np.float32([0, 40, 0])  # cm above the head
    few[7:10] = few[7:10, :1]
    file, out = tmp_path / "some.npz", tmp_path / "out.npz"
    np.savez(file, strands=np.concatenate([few, few[20:25] + np.float32(1e-3)]))
    main(["groom", "import", str(file), "--out", str(out), "--ties", "none"])
    lines = capfd.readouterr().out.splitlines()
    used = len(few) - 10 + 5
    reasons = "3 far shorter than the others, 7 with a root more than 35 mm from the scalp"
    assert f"strands: {used} of {used + 10} are hair of the scalp; left out: {reasons}" in lines
    (draped,) = [line for line in lines if line.startswith("draped: ")]
    assert draped.startswith(f"draped: {used - 5} of these {used}, one in each cell of a 64 x 64 grid")
    assert "quaffure drape --strands original shows all of them" in draped
    report = [line for line in lines if line.split(":")[0] in (str(file), "strands", "roots", "skin", "draped")]
    assert len(report) == 5
    main(["drape", str(file), "--draper", "posed", "--frames", "0", "--out", str(tmp_path / "drape.npz")])
    assert [line for line in capfd.readouterr().out.splitlines() if line in report] == report


def test_import_says_what_a_file_gets_from_another(
    tmp_path: Path, foreign: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]
) -> None:
    """A file with widths beside one without them: groups by file, and no strand of width 0."""
    (tmp_path / "thick.hair").write_bytes(hair_bytes([*np.load(foreign / "b.npz")["strands"]], 7))
    out = tmp_path / "both.npz"
    main(["groom", "import", str(foreign / "a.npz"), str(tmp_path / "thick.hair"), "--ties", "none", "--out", str(out)])
    message = " ".join(capfd.readouterr().out.split())
    assert "1 of 2 files have widths: strands of the others get the median of these" in message
    attributes = load_source(out, body).attributes
    assert attributes.width is not None
    assert np.ptp(attributes.width) == 0 < attributes.width[0]
    assert attributes.group_names == ("a", "thick")


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_import_finds_ties_and_keeps_those_of_the_file(
    tmp_path: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]
) -> None:
    groom = make_groom(with_settings(STYLES["ponytail"], ("root_rows=24",)), body)
    np.savez(tmp_path / "tail.npz", strands=100 * groom.rest_strands.numpy())
    out, picture = tmp_path / "out.npz", tmp_path / "tail.png"
    arguments = ["groom", "import", str(tmp_path / "tail.npz"), "--out", str(out)]
    main([*arguments, "--picture", str(picture)])
    message = " ".join(capfd.readouterr().out.split())
    assert f"ties found: {len(groom)} of {len(groom)} strands are tied" in message
    assert "the held parts in blue" in message
    found = read_groom(out, body)
    assert found.tie_vertex is not None
    assert (found.tie_vertex > 0).all()
    assert found.held_edges.any()
    from PIL import Image

    with Image.open(picture) as image:
        pixels = np.asarray(image).astype(int)
    assert pixels.shape == (192, 192, 3)
    blue = pixels[..., 2] - pixels[..., 0] > 25
    assert blue[:, :128].mean() < 0.001 < blue[:, 128:].mean()
    main([*arguments, "--ties", "none"])
    assert "ties were not searched for" in capfd.readouterr().out
    assert read_groom(out, body).tie_vertex is None
    reports: list[RegistrationReport] = []
    loaded = load_groom(tmp_path / "tail.npz", body, on_report=reports.append)
    assert loaded.tie_vertex is not None
    assert f"ties found: {len(groom)} of {len(groom)} strands are tied" in str(reports[0])
    usd = tmp_path / "tail.usdc"
    write_groom(tmp_path / "own.npz", groom)
    main(["drape", str(tmp_path / "own.npz"), "--draper", "posed", "--frames", "0:1", "--out", str(usd)])
    main(["groom", "import", str(usd), "--out", str(out), "--ties", "none"])
    assert f"ties of the file: {len(groom)} of {len(groom)}" in capfd.readouterr().out


# --- hold ------------------------------------------------------------------------------------------------------------


def test_hold_edits_a_region_of_the_scalp(tmp_path: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]) -> None:
    first, gelled, tied, free = (tmp_path / f"{name}.npz" for name in ("first", "gelled", "tied", "free"))
    groom = make_groom(with_settings(STYLES["long_straight"], (FEW_ROOTS,)), body)
    write_groom(first, groom)
    main(["groom", "hold", str(first), "--where", "left", "z>0.02", "--length", "0.08", "--out", str(gelled)])
    roots = groom.rest_strands[:, 0] - body.rest_joints[body.joint_names.index("Head")]
    chosen = (roots[:, 0] > 0) & (roots[:, 2] > 0.02)
    assert f"changed {int(chosen.sum())} of {len(groom)} strands" in capfd.readouterr().out
    once = read_groom(gelled, body)
    assert once.name == "gelled"
    assert torch.equal(once.held_edges.any(1), chosen)
    main(["groom", "hold", str(gelled), "--where", "nape", "--tie", "0.15", "--out", str(tied)])
    twice = read_groom(tied, body)
    assert twice.tie_vertex is not None
    assert torch.equal(twice.tie_vertex >= 0, groom.root_uv[:, 1] > 0.67)
    main(["groom", "hold", str(tied), "--release", "--out", str(free)])
    assert not read_groom(free, body).held_edges.any()


def test_hold_keeps_the_strands_that_a_groom_was_registered_from(tmp_path: Path, body: BodyModel) -> None:
    rest = make_groom("bob", body).rest_strands[::60]
    np.savez(tmp_path / "bob.npz", strands=rest.numpy())
    imported, held = tmp_path / "imported.npz", tmp_path / "held.npz"
    main(["groom", "import", str(tmp_path / "bob.npz"), "--registered", "--out", str(imported)])
    main(["groom", "hold", str(imported), "--length", "0.05", "--out", str(held)])
    before, after = read_source(imported), read_source(held)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(after.points, before.points)


def test_bad_holds(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    hold = ("groom", "hold", "bob", "--out", tmp_path / "out.npz")
    assert "expected one of --length, --tie and --release, found none" in refused(capfd, *hold)
    assert "found --length, --release" in refused(capfd, *hold, "--length", "0.1", "--release")
    assert "--tie: expected metres above 0" in refused(capfd, *hold, "--tie", "0")
    assert "--length: expected metres above 0" in refused(capfd, *hold, "--length", "nan")
    for condition in ("beard", "w>1", "x>", "x>1e", "x=1"):
        assert "--where: expected one of all, left" in refused(capfd, *hold, "--release", "--where", condition)
    assert "found x>5" in refused(capfd, *hold, "--release", "--where", "x>5")
    assert not list(tmp_path.iterdir())


def test_bad_imports(tmp_path: Path, capfd: pytest.CaptureFixture[str], foreign: Path) -> None:
    out = ("--out", tmp_path / "out.npz")
    missing = tmp_path / "missing.hair"
    assert f"{missing}: expected" in refused(capfd, "groom", "import", missing, *out)
    cut = tmp_path / "cut.tfx"
    cut.write_bytes(tfx4_bytes([np.zeros((8, 3))])[:-10])
    assert f"{cut}: expected" in refused(capfd, "groom", "import", cut, *out)
    cut.unlink()
    line = refused(capfd, "groom", "import", foreign / "a.npz", *out, "--picture", tmp_path / "x.jpg")
    assert "x.jpg: expected an output of suffix .png" in line
    line = refused(capfd, "groom", "import", foreign / "a.npz", *out, "--head", tmp_path / "head.obj")
    assert "head.obj: expected a head mesh" in line
    assert "FILE" in refused(capfd, "groom", "import", *out)
    assert "comb" in refused(capfd, "groom", "comb")
    assert not list(tmp_path.iterdir())


# --- strands ---------------------------------------------------------------------------------------------------------


def test_strands_go_to_usd_and_guides_stay_in_the_drape(drape: Path) -> None:
    with np.load(drape) as file:
        guides = file["strands"].shape
    assert guides[1] < 200
    assert len(read_strands(drape.with_suffix(".usd")).counts) == 700


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_render_draws_what_was_kept(tmp_path: Path, drape: Path) -> None:
    outputs = [tmp_path / f"hair{suffix}" for suffix in (".png", ".mp4", ".usdc")]
    asked = [word for path in outputs for word in ("--out", str(path))]
    main(["render", str(drape), "--strands", "900", *asked])
    assert outputs[0].read_bytes().startswith(b"\x89PNG")
    assert b"ftyp" in outputs[1].read_bytes()[:16]
    assert len(read_strands(outputs[2]).counts) == 900
    main(["render", str(drape), "--out", str(tmp_path / "guides.png")])
    assert (tmp_path / "guides.png").read_bytes() != outputs[0].read_bytes()


def test_bad_renders(tmp_path: Path, drape: Path, capfd: pytest.CaptureFixture[str], body: BodyModel) -> None:
    out = ("--out", tmp_path / "hair.png")
    assert "expected 1 to 1000000, found 0" in refused(capfd, "render", drape, "--strands", "0", *out)
    missing = tmp_path / "missing.npz"
    assert f"{missing}: expected a drape file" in refused(capfd, "render", missing, *out)
    assert "expected a picture, a video or a file for another program" in refused(
        capfd, "render", drape, "--out", tmp_path / "hair.npz"
    )
    assert "--out: expected at least one file" in refused(capfd, "render", drape)
    write_groom(missing, make_groom(with_settings(STYLES["bob"], (FEW_ROOTS,)), body).select(torch.arange(2)))
    line = refused(capfd, "drape", missing, "--draper", "posed", "--strands", "50", *out)
    assert "expected three guides or more" in line
    missing.unlink()
    assert not list(tmp_path.iterdir())


def test_text_usd_that_would_not_fit_memory_is_refused(
    tmp_path: Path, drape: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("quaffure.apps.cli.outputs.MOST_BYTES", 1e5)
    line = refused(capfd, "render", drape, "--strands", "900", "--out", tmp_path / "hair.usda")
    assert "expected at most 0.0001 GB of strands in a text file" in line
    assert not list(tmp_path.iterdir())
    check_outputs([tmp_path / "hair.png"], ())
