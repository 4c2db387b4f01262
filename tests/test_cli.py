"""The command line: what it writes, and one line with exit code 2 for every mistake that a user can make."""

import importlib.util
import json
import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from numba import njit
from pxr import Sdf

from quaffure import HairMaterial, InputError
from quaffure.apps.cli.drape_report import Stopwatch, duration, with_preparation
from quaffure.apps.cli.kernel_cache import KernelSeconds, announced_compiling, kernel_seconds
from quaffure.apps.cli.main import main
from quaffure.baselines import PosedDraper
from quaffure.benchmark import DrapeMetrics
from quaffure.benchmark.metrics import UNITS
from quaffure.body import CLIP_NAMES, BodyModel, Motion, PosedBody, load_body
from quaffure.drape_motion import FRAMES_AT_ONCE, drape_motion
from quaffure.hair import Groom
from quaffure.io import read_drape, write_drape, write_groom, write_usd
from quaffure.io.read_strands import read_strands
from quaffure.model import NetworkConfig, build_network, quaffure_model, save_network
from quaffure.procedural import STYLES, make_groom
from quaffure.scene import BodyBatch, Scene
from tests.synthetic_drape import drape as synthetic_drape
from tests.synthetic_drape import patch_of_strands
from tests.test_bvh import TWO_JOINTS
from tests.test_groom_files import GOOD, data_bytes, hair_bytes, npz_bytes, tfx4_bytes

STRANDS = 60


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    whole = make_groom("bob", body)
    return whole.select(torch.linspace(0, len(whole) - 1, STRANDS).long())


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, groom: Groom) -> Path:
    """A folder with a small groom and a small network."""
    folder = tmp_path_factory.mktemp("inputs")
    write_groom(folder / "tiny.npz", groom)
    torch.manual_seed(0)
    network = build_network(NetworkConfig(texel_channels=4, strand_width=8))
    save_network(folder / "tiny.safetensors", network, HairMaterial(), {"trained": "not at all"})
    return folder


class Refusal:
    """Runs a command that must fail the way a user can bear."""

    def __init__(self, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
        self.folder, self.capfd = folder, capfd
        self.out = folder / "out"
        self.out.mkdir()

    def __call__(self, *arguments: str | Path, without_out: bool = False) -> str:
        """The one line on the error stream."""
        out = [] if without_out else ["--out", str(self.out / "hair.npz"), "--out", str(self.out / "hair.usd")]
        with pytest.raises(SystemExit) as stop:
            main([*map(str, arguments), *out])
        errors = self.capfd.readouterr().err
        assert stop.value.code == 2, errors
        assert errors.startswith("quaffure: ")
        assert errors.count("\n") == 1
        assert errors.endswith("\n")
        assert not list(self.out.iterdir())
        return errors

    def saved(self, name: str, content: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(content)
        return path


@pytest.fixture
def refusal(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Refusal:
    return Refusal(tmp_path, capfd)


def posed(groom: Path | str, *more: str) -> tuple[str, ...]:
    return ("drape", str(groom), "--draper", "posed", *more)


# --- what is written -------------------------------------------------------------------------------------------------


def test_each_frame_is_posed_once_measuring_and_writing_included(
    tmp_path: Path, inputs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames: list[int] = []
    skin = BodyModel.skin

    def counted(self: BodyModel, body_shape: torch.Tensor, *joints: torch.Tensor) -> PosedBody:
        frames.append(len(body_shape))
        return skin(self, body_shape, *joints)

    outputs = [part for name in ("d.npz", "d.usda") for part in ("--out", str(tmp_path / name))]
    reference = ("--reference", str(tmp_path / "d.npz"))
    main([*posed(inputs / "tiny.npz"), "--motion", "nod", "--frames", "0:12", *outputs])
    monkeypatch.setattr(BodyModel, "skin", counted)
    main(
        [
            *posed(inputs / "tiny.npz"),
            "--motion",
            "nod",
            "--frames",
            "0:12",
            *reference,
            "--out",
            str(tmp_path / "e.npz"),
        ]
    )
    assert sum(frames) == 12


@pytest.mark.usefixtures("small_pictures")
def test_drape_writes_every_format_and_prints_figures(
    tmp_path: Path, inputs: Path, groom: Groom, capfd: pytest.CaptureFixture[str]
) -> None:
    outputs = [tmp_path / f"hair{suffix}" for suffix in (".npz", ".usd", ".png", ".mp4")]
    asked = [word for path in outputs for word in ("--out", str(path))]
    main(
        [*posed(inputs / "tiny.npz", "--frames", "0:3", "--shape=-1,0,0,0,0,0,0,0,0,2", "--metrics", "--json"), *asked]
    )
    printed = json.loads(capfd.readouterr().out)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in outputs)

    drape = read_drape(outputs[0])
    assert drape.strands.shape == (3, STRANDS, 24, 3)
    np.testing.assert_array_equal(drape.strands, drape.posed)
    assert drape.body_shape.tolist() == [-1, 0, 0, 0, 0, 0, 0, 0, 0, 2]
    assert drape.meta["draper"] == "posed"
    assert drape.meta["motion"] == "neck_turn"
    np.testing.assert_allclose(read_strands(outputs[1]).points, drape.strands[0].reshape(-1, 3), atol=1e-6)
    assert outputs[2].read_bytes().startswith(b"\x89PNG")
    assert b"ftyp" in outputs[3].read_bytes()[:16]

    assert printed["meta"]["groom"] == groom.name
    assert printed["milliseconds"] > 0
    assert printed["with_preparation"] is True
    steps = ["kernels", "preparation", "draping", "checks", "metrics", "files", "pictures"]
    assert list(printed["seconds"]) == steps
    assert all(printed["seconds"][step] > 0 for step in steps[1:])
    metrics = printed["per_frame"]["posed"]
    assert all(len(per_frame) == 3 for per_frame in metrics.values())
    assert max(metrics["orientation_error_deg"]) < 1e-3
    assert max(metrics["length_error_percent"]) < 0.01
    assert min(metrics["body_intersection_percent"]) >= 0


@pytest.mark.slow
def test_adam_settles_one_frame_and_serves_as_reference(
    tmp_path: Path, inputs: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    groom, reference = str(inputs / "tiny.npz"), tmp_path / "adam.npz"
    main(["drape", groom, "--draper", "adam", "--frames", "40:41", "--metrics", "--out", str(reference)])
    table = capfd.readouterr().out
    assert "body_intersection_percent │ %" in table
    assert "energy                    │ m g L per vertex" in table
    assert "definitions: docs/metrics.md" in table
    assert re.search(
        r"^time: kernels .* \((compiled|loaded).*\), preparation .*, draping .* \(1 frame\), ", table, re.M
    )
    assert str(reference) in table.replace("\n", "")
    out = ["--out", str(tmp_path / "posed.npz"), "--json"]
    main([*posed(groom, "--frames", "40:41", "--reference", str(reference)), *out])
    metrics = json.loads(capfd.readouterr().out)["per_frame"]["posed"]
    assert metrics["excess_energy"][0] > 0
    assert metrics["distance_mm"][0] > 1


def test_the_rod_keeps_the_design_or_gravity_bends_it(tmp_path: Path, groom: Groom) -> None:
    path, moved = tmp_path / "few.npz", {}
    write_groom(path, groom.select(torch.arange(0, STRANDS, 10)))
    # In the first frame the body is nearly upright, as it was when the hair was designed.
    options = ("--draper", "lbfgs", "--elastic", "rod", "--frames", "0:1")
    for rest, chosen in (("design", ()), ("stress-free", ("--rest", "stress-free"))):
        out = tmp_path / f"{rest}.npz"
        main(["drape", str(path), *options, *chosen, "--out", str(out)])
        drape = read_drape(out)
        assert (drape.meta["elastic"], drape.meta["rest"]) == ("rod", rest)
        moved[rest] = np.linalg.norm(drape.strands - drape.posed, axis=-1).mean()
    assert 5 * moved["design"] < moved["stress-free"]
    assert moved["design"] < 2e-3  # m


def test_a_rest_shape_needs_the_rod_and_the_rod_a_solver(refusal: Refusal, inputs: Path) -> None:
    tiny = inputs / "tiny.npz"
    line = refusal("drape", tiny, "--draper", "xpbd_paper", "--rest", "design")
    assert "--rest: expected --elastic rod" in line
    other = ("--draper", "neural", "--elastic", "modified_cosserat")
    assert "--elastic: expected rod with neural" in refusal("drape", tiny, *other)
    for draper, elastic in (("strand_newton", "cosserat"), ("xpbd_paper", "rod")):
        line = refusal("drape", tiny, "--draper", draper, "--elastic", elastic)
        assert f"--elastic: expected a model that {draper} minimizes" in line
        assert f"found '{elastic}'" in line
    assert "--rest: expected design" in refusal("drape", tiny, "--draper", "neural", "--rest", "stress-free")
    assert "--rest" in refusal("drape", tiny, "--draper", "lbfgs", "--elastic", "rod", "--rest", "stiff")


def test_neural_drapes_with_own_weights(tmp_path: Path, inputs: Path) -> None:
    out = tmp_path / "hair.npz"
    weights = str(inputs / "tiny.safetensors")
    arguments = ["--draper", "neural", "--weights", weights, "--frames", "0:1"]
    main(["drape", str(inputs / "tiny.npz"), *arguments, "--out", str(out)])
    drape = read_drape(out)
    assert drape.meta["draper"] == "neural"
    segments = np.linalg.norm(np.diff(drape.strands[0], axis=1), axis=-1)
    np.testing.assert_allclose(segments, drape.rest_lengths, rtol=1e-3, atol=1e-6)


def test_settling_lowers_the_energy(tmp_path: Path, inputs: Path, capfd: pytest.CaptureFixture[str]) -> None:
    energies = []
    for passes, row in (("1", "neural_settled"), ("6", "neural_settled")):
        out = str(tmp_path / f"{passes}.npz")
        arguments = ["--draper", "neural", "--settle", passes, "--frames", "40:41", "--metrics", "--json"]
        main(["drape", str(inputs / "tiny.npz"), *arguments, "--out", out])
        report = json.loads(capfd.readouterr().out)
        energies += report["per_frame"][row]["energy"]
    assert report["meta"]["elastic"] == "rod"
    assert energies[1] < energies[0]


def test_every_metric_has_a_unit(body: BodyModel, groom: Groom) -> None:
    scene = Scene(groom, BodyBatch(body, torch.zeros(3, 81), torch.zeros(3, 10)))
    reference = drape_motion(PosedDraper(), groom, body, Motion(torch.zeros(3, 81), 30.0, "rest"), torch.zeros(10))
    measured = DrapeMetrics(groom, HairMaterial(), reference)
    measured.add(scene.posed, scene)
    found, _ = measured.of_all_frames()
    assert set(found) <= set(UNITS)
    assert set(UNITS) - set(found) == {"jitter"}  # only of a reference that moves


@pytest.mark.parametrize(("fps", "jumps"), [(30.0, 60.0), (7.5, 0.0)])
def test_tips_jump_by_their_speed(body: BodyModel, groom: Groom, fps: float, jumps: float) -> None:
    scene = Scene(groom, BodyBatch(body, torch.zeros(2, 81), torch.zeros(2, 10)))
    draped = scene.posed.clone()
    draped[1, :, -1, 0] += 0.1
    measured = DrapeMetrics(groom, HairMaterial(), fps=fps)
    measured.add(draped, scene)
    assert measured.of_all_frames()[0]["jumps"].tolist() == [0.0, jumps]


def test_time_is_counted_to_the_step_that_ends() -> None:
    times = Stopwatch()
    for step in ("draping", "metrics", "draping"):
        before = sum(times.seconds.values())
        times.lap(step)
        assert sum(times.seconds.values()) >= before
    assert list(times.seconds) == ["kernels", "draping", "metrics"]


def test_the_compilation_of_kernels_is_no_part_of_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel that is compiled while a frame is draped is not draping."""
    clock = iter([0.0, 5.0, 105.0, 106.0])
    kernels = iter([KernelSeconds(1, 0), KernelSeconds(3, 0), KernelSeconds(93, 80), KernelSeconds(93, 80)])
    monkeypatch.setattr("quaffure.apps.cli.drape_report.kernel_seconds", lambda: next(kernels))
    monkeypatch.setattr("quaffure.apps.cli.drape_report.time", SimpleNamespace(perf_counter=lambda: next(clock)))
    times = Stopwatch()
    times.lap("preparation")
    assert times.text({}) == "kernels 2 s (loaded), preparation 3 s"
    times.lap("draping")
    times.lap("checks")
    assert times.text({"draping": "2 frames"}) == (
        "kernels 92 s (compiled; first use of this feature only), preparation 3 s, draping 10 s (2 frames), checks 1 s"
    )


def test_numba_says_how_long_it_compiles() -> None:
    before = kernel_seconds()
    njit(lambda x: np.sort(x).sum())(np.ones(3))
    after = kernel_seconds()
    assert after.compiling > before.compiling
    assert after.total - before.total >= after.compiling - before.compiling
    assert kernel_seconds() == after


def test_compiling_is_announced_once_and_loading_not(tmp_path: Path) -> None:
    source = tmp_path / "kernels.py"
    source.write_text("from numba import njit\n@njit(cache=True)\ndef twice(x):\n    return 2 * x\n", encoding="utf-8")
    specification = importlib.util.spec_from_file_location("kernels", source)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    said: list[str] = []
    for expected in (1, 1):
        specification.loader.exec_module(module)  # as the next process does
        with announced_compiling(lambda: said.append("compiling")):
            module.twice(1)
            assert len(said) == expected
    with announced_compiling(lambda: said.append("compiling")):
        module.twice(1.0)
        module.twice(1j)
    assert len(said) == 2


def test_grooms_keep_their_contract(capfd: pytest.CaptureFixture[str]) -> None:
    main(["grooms", "--json"])
    rows = json.loads(capfd.readouterr().out)
    assert [row["name"] for row in rows] == list(STYLES)
    for row in rows:
        assert {"name", "style", "strands", "length_m", "licence", "held_out"} <= row.keys()
        assert 0.003 < row["length_m"] < 0.8
        assert 500 < row["strands"] <= 4096
        assert row["licence"]
        assert isinstance(row["held_out"], bool)


def test_info_prints_terms(inputs: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(quaffure_model, "WEIGHTS", inputs / "tiny.safetensors")
    main(["info", "--json"])
    rows = {row["part"]: row for row in json.loads(capfd.readouterr().out)}
    assert {"quaffure", "body", "pose prior", "clips", "grooms", "weights"} <= rows.keys()
    assert all(row["terms"] for row in rows.values())
    assert rows["weights"]["what"] == "trained not at all"
    main(["info"])
    assert "mocap.cs.cmu.edu" in capfd.readouterr().out


def test_shipped_weights_load() -> None:
    assert quaffure_model.load_model().notes


def test_help_of_the_command_and_of_the_module_is_no_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["drape", "--help"])
    assert not stop.value.code
    assert "--motion" in capfd.readouterr().out
    words = [sys.executable, "-m", "quaffure", "evaluate", "--help"]
    run = subprocess.run(words, capture_output=True, text=True, check=True)
    assert run.stdout.startswith("usage: quaffure evaluate")
    assert "shared options" in run.stdout


# --- grooms ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".hair", ".data", ".bin", ".tfx", ".npz", ".usd"])
def test_missing_grooms(refusal: Refusal, suffix: str) -> None:
    path = refusal.folder / f"missing{suffix}"
    line = refusal(*posed(path))
    assert f"{path}: expected" in line
    assert "found no such file" in line


@pytest.mark.parametrize("name", ["hair ragged", "hair all", "data", "bin", "tfx 3", "tfx 4", "npz ragged", "npz even"])
def test_truncated_strand_files(refusal: Refusal, name: str) -> None:
    suffix, content, _ = GOOD[name]
    for end in (0, len(content) // 2, len(content) - 1):
        path = refusal.saved(f"cut{suffix}", content[:end])
        line = refusal(*posed(path))
        assert f"{path}: expected " in line
        assert ", found " in line


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc"])
def test_truncated_usd_files(refusal: Refusal, suffix: str) -> None:
    path = refusal.folder / f"cut{suffix}"
    write_usd(path, synthetic_drape(patch_of_strands((0, 0, 1))))
    content = path.read_bytes()
    for end in (0, 4, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:end])
        line = refusal(*posed(path))
        assert f"{path}: expected " in line
        assert ", found " in line


def test_truncated_groom_files(refusal: Refusal, inputs: Path) -> None:
    content = (inputs / "tiny.npz").read_bytes()
    path = refusal.saved("cut.npz", content[: len(content) // 2])
    assert f"{path}: expected " in refusal(*posed(path))


def test_grooms_with_nan(refusal: Refusal, inputs: Path) -> None:
    path = refusal.saved("nan.data", data_bytes([np.array([[0, 0, 0], [0, np.nan, 1]])]))
    assert f"{path}: expected finite coordinates within 1e+09, found NaN" in refusal(*posed(path))
    with np.load(inputs / "tiny.npz") as file:
        arrays = dict(file)
    arrays["rest_strands"][0, 5] = np.nan
    path = refusal.saved("nan.npz", npz_bytes(**arrays))
    assert f"{path}: expected a groom file (.npz) with finite rest_strands, found NaN" in refusal(*posed(path))


EMPTY = {
    "none.hair": hair_bytes([], 1 | 2),
    "none.data": data_bytes([]),
    "bald.data": data_bytes([np.zeros((1, 3))] * 9),
    "none.bin": data_bytes([]),
    "none.tfx": tfx4_bytes([]),
    "none.npz": npz_bytes(points=np.zeros((0, 3)), counts=np.zeros(0, dtype=np.int64)),
    "none.usda": b'#usda 1.0\ndef Xform "Hair" {}\n',
}


@pytest.mark.parametrize("name", EMPTY)
def test_grooms_with_no_strands(refusal: Refusal, name: str) -> None:
    path = refusal.saved(name, EMPTY[name])
    line = refusal(*posed(path))
    assert f"{path}: expected at least one strand" in line
    assert "found no strands" in line


@pytest.mark.slow
def test_a_random_cloud_is_no_groom(refusal: Refusal) -> None:
    cloud = np.random.default_rng(0).uniform(-1, 1, (1000, 12, 3))
    path = refusal.saved("cloud.npz", npz_bytes(strands=cloud))
    assert f"{path}: expected roots " in refusal(*posed(path))


def test_unknown_names(refusal: Refusal) -> None:
    line = refusal(*posed("beehive"))
    assert "beehive: expected a bundled groom" in line
    assert all(name in line for name in STYLES)
    line = refusal(*posed("bob", "--motion", "backflip"))
    assert "'backflip': expected" in line
    assert all(name in line for name in CLIP_NAMES)


def test_unknown_formats(refusal: Refusal) -> None:
    path = refusal.saved("hair.txt", b"hair")
    line = refusal(*posed(path))
    assert f"{path}: expected a strand file" in line
    assert ".txt" in line
    path = refusal.saved("dance.mov", b"dance")
    assert f"{path}: expected a motion file" in refusal(*posed("bob", "--motion", str(path)))
    path = refusal.saved("dance.fbx", b"; FBX 7.4.0 project file")
    line = refusal(*posed("bob", "--motion", str(path)))
    assert f"{path}: expected a binary FBX file" in line
    assert "found an FBX of text" in line


# --- motion ----------------------------------------------------------------------------------------------------------


def test_missing_motion(refusal: Refusal) -> None:
    path = refusal.folder / "missing.bvh"
    line = refusal(*posed("bob", "--motion", str(path)))
    assert f"{path}: expected a motion file" in line
    assert "found no such file" in line


def test_motion_without_the_needed_joints(refusal: Refusal) -> None:
    path = refusal.saved("arm.bvh", TWO_JOINTS.encode())
    line = refusal(*posed("bob", "--motion", str(path)))
    assert f"{path}: expected " in line
    assert "none for Spine1, Head, LeftArm" in line
    assert 'Known: Hips = "hip"' in line


def test_truncated_motion(refusal: Refusal) -> None:
    for end in (0, 60, 200, len(TWO_JOINTS) - 24):
        path = refusal.saved("cut.bvh", TWO_JOINTS[:end].encode())
        line = refusal(*posed("bob", "--motion", str(path)))
        assert f"{path}, line " in line
        assert ": expected " in line


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"body_pose": np.full((4, 81), np.nan), "fps": 30.0}, "expected finite joint angles, found NaN"),
        ({"body_pose": np.zeros((4, 72)), "fps": 30.0}, "expected body poses [frames >= 1, 81], found [4, 72]"),
        ({"body_pose": np.zeros((4, 81))}, "expected one number fps"),
        ({"body_pose": np.zeros((4, 81)), "fps": 0.0}, "expected a frame rate above 0"),
        ({"poses": np.full((4, 66), np.inf), "mocap_framerate": 60.0}, "expected finite joint angles"),
        ({"poses": np.zeros((4, 9)), "mocap_framerate": 60.0}, "expected poses [1 to 100000 frames, 66 or more]"),
        ({"poses": np.zeros((4, 66))}, "expected one number mocap_framerate"),
        ({"something": np.zeros(3)}, "expected arrays of numbers poses"),
    ],
)
def test_bad_motion_arrays(refusal: Refusal, arrays: dict[str, np.ndarray], expected: str) -> None:
    path = refusal.saved("motion.npz", npz_bytes(**arrays))
    assert f"{path}: {expected}" in refusal(*posed("bob", "--motion", str(path)))


@pytest.mark.parametrize("frames", ["5:2", "0:100000", "::0", "a:b", "100000", "-3:", "1:2:3:4"])
def test_bad_frames(refusal: Refusal, frames: str) -> None:
    assert f"frames '{frames}': expected " in refusal(*posed("bob", f"--frames={frames}"))


# --- shape -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ("1,2,3", "expected 10 coefficients, found 3"),
        ("0,0,0,0,0,0,0,0,0,0,0", "expected 10 coefficients, found 11"),
        ("-1,0", "expected 10 coefficients, found 2"),
        ("tall", "expected numbers separated by commas, found 'tall'"),
        ("0,0,0,0,0,0,0,0,0,nan", "expected coefficients within +-10"),
        ("0,0,0,0,0,0,0,0,0,1e30", "expected coefficients within +-10"),
        ("0," * 400, "expected 10 coefficients, found 400"),
    ],
)
def test_bad_shape_vectors(refusal: Refusal, shape: str, expected: str) -> None:
    assert f"shape '{shape}': {expected}" in refusal(*posed("bob", "--shape", shape))


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("missing.txt", None, "no such file"),
        ("missing.npz", None, "no such file"),
        ("three.txt", b"1 2 3\n", "expected 10 coefficients, found 3"),
        ("words.csv", b"a,b,c", "expected numbers separated by commas, found 'a'"),
        ("binary.txt", b"\xff\xfe\x00", "expected a text file"),
        ("nan.txt", b"nan " * 10, "expected coefficients within"),
        ("other.npz", npz_bytes(beta=np.zeros(10)), "expected 10 coefficients, found 0"),
        ("cut.npz", npz_bytes(body_shape=np.zeros(10))[:100], "expected an undamaged .npz"),
    ],
)
def test_bad_shape_files(refusal: Refusal, name: str, content: bytes | None, expected: str) -> None:
    path = refusal.folder / name
    if content is not None:
        path.write_bytes(content)
    line = refusal(*posed("bob", "--shape", str(path)))
    assert str(path) in line
    assert expected in line


def test_shape_files_are_read(tmp_path: Path, inputs: Path) -> None:
    shape = tmp_path / "shape"
    shape.write_text("0.5 0 0 0 0\n0 0 0 0 -1\n")
    drapes = []
    for source, out in ((shape, tmp_path / "a.npz"), (tmp_path / "a.npz", tmp_path / "b.npz")):
        main([*posed(inputs / "tiny.npz", "--frames", "0:1", "--shape", str(source)), "--out", str(out)])
        drapes.append(read_drape(out).body_shape.tolist())
    assert drapes == [[0.5, 0, 0, 0, 0, 0, 0, 0, 0, -1]] * 2


# --- outputs, reference, weights, options ----------------------------------------------------------------------------


def test_bad_outputs(refusal: Refusal, inputs: Path) -> None:
    groom = posed(inputs / "tiny.npz")
    line = refusal(*groom, "--out", refusal.out / "hair.docx")
    assert f"{refusal.out / 'hair.docx'}: expected an output of suffix .npz, .usd" in line
    assert "found suffix '.docx'" in line
    absent = refusal.folder / "absent" / "hair.npz"
    assert f"{absent}: expected a path in an existing folder, found no folder" in refusal(*groom, "--out", absent)
    folder = refusal.folder / "folder.npz"
    folder.mkdir()
    assert f"{folder}: expected a file to write, found a folder" in refusal(*groom, "--out", folder)
    assert "--out: expected at least one file" in refusal(*groom, without_out=True)


def test_a_writer_that_fails_leaves_nothing(refusal: Refusal, inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def half_written(self: Sdf.Layer) -> bool:
        Path(self.realPath).write_bytes(b"PXR-USDC")
        return False

    monkeypatch.setattr("pxr.Sdf.Layer.Save", half_written)
    out = ["--out", refusal.out / "hair.usd"]
    line = refusal(*posed(inputs / "tiny.npz", "--frames", "0:1"), *out, without_out=True)
    assert "hair.usd: expected a file that can be written" in line


def test_bad_references(refusal: Refusal, inputs: Path) -> None:
    other = refusal.folder / "other.npz"
    write_drape(other, synthetic_drape(patch_of_strands((0, 0, 1))))
    line = refusal(*posed(inputs / "tiny.npz", "--frames", "0:3", "--reference", str(other)))
    assert f"{other}: expected strands (3, {STRANDS}, 24, 3), found (3, 150, 8, 3)" in line
    cut = refusal.saved("cut.npz", other.read_bytes()[:1000])
    assert f"{cut}: expected a drape file" in refusal(*posed("bob", "--reference", str(cut)))


def pickled(whole: bytes) -> bytes:
    return b"\x80\x04\x95" + whole[:200]


def forged_header(whole: bytes) -> bytes:
    return struct.pack("<Q", 2**62) + whole[8:]


@pytest.mark.parametrize(
    "damage", [lambda w: b"", lambda w: w[: len(w) // 2], lambda w: w[:-1], pickled, forged_header]
)
def test_bad_weights(refusal: Refusal, inputs: Path, damage: Callable[[bytes], bytes]) -> None:
    path = refusal.saved("bad.safetensors", damage((inputs / "tiny.safetensors").read_bytes()))
    line = refusal("drape", inputs / "tiny.npz", "--weights", path)
    assert f"{path}: expected a checkpoint (.safetensors), found " in line


def test_missing_weights(refusal: Refusal) -> None:
    path = refusal.folder / "missing.safetensors"
    assert f"{path}: expected a checkpoint (.safetensors), found no such file" in refusal(
        "drape", "bob", "--weights", path
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["drape", "bob", "--draper", "magic"], "--draper: expected one of strand_newton, adam"),
        (["drape", "bob", "--model", "published"], "--model: expected quaffure or paper, with the network"),
        (["drape", "bob", "--model", "paper", "--draper", "xpbd"], "--model: expected quaffure or paper"),
        (["drape", "bob", "--model", "paper", "--elastic", "rod"], "--elastic: expected modified_cosserat"),
        (["drape", "bob", "--settle", "3"], "--settle: expected another draper than strand_newton"),
        (["drape", "bob", "--stiffness", "0"], "--stiffness: expected a factor above 0, at most 100, found 0"),
        (["drape", "bob", "--weight", "1e3"], "--weight: expected a factor above 0, at most 100, found 1000"),
        (["drape", "bob", "--colour", "red"], "--colour"),
        (["drape", "bob", "--picture", "x.png"], "unknown option --picture;"),  # one of another command
        (["drape"], "GROOM"),
        (["drape", "bob", "--motion"], "--motion"),
        (["comb"], "comb"),
        ([], "drape, train"),
    ],
)
def test_bad_options(refusal: Refusal, arguments: list[str], message: str) -> None:
    line = refusal(*arguments, without_out="bob" not in arguments or "--motion" in arguments)
    assert message in line
    assert "│" not in line


def test_help_ends_quietly_where_its_reader_does() -> None:
    command = f"{sys.executable} -m quaffure drape --help | head -n 1"
    ended = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert ended.stdout.startswith("usage: quaffure drape")
    assert not ended.stderr


def test_threads_that_wait_do_not_spin_unless_the_user_asks() -> None:
    command = [sys.executable, "-c", "import os, quaffure; print(os.environ['OMP_WAIT_POLICY'])"]
    for given, expected in (({}, "passive"), ({"OMP_WAIT_POLICY": "active"}, "active")):
        own = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"} | given
        assert subprocess.run(command, env=own, capture_output=True, text=True, check=True).stdout.strip() == expected


def test_reasons_of_several_lines_are_printed_in_one(refusal: Refusal) -> None:
    path = refusal.folder / "two\nlines.hair"
    assert "two lines.hair: expected" in refusal(*posed(path))


def test_python_errors_are_input_errors() -> None:
    with pytest.raises(InputError, match="no such file"):
        quaffure_model.load_model(Path("missing.safetensors"))


@pytest.mark.parametrize(("frames", "prepared"), [(1, True), (FRAMES_AT_ONCE, True), (FRAMES_AT_ONCE + 1, False)])
def test_the_time_of_a_few_frames_holds_what_is_prepared_once(frames: int, prepared: bool) -> None:
    assert with_preparation(range(frames)) is prepared


@pytest.mark.parametrize(("milliseconds", "message"), [(4.213, "4.21 ms"), (999.0, "999 ms"), (12345.0, "12.3 s")])
def test_times_are_printed_in_ms_or_s(milliseconds: float, message: str) -> None:
    assert duration(milliseconds) == message
