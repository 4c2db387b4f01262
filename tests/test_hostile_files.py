"""Files that are made to do harm, or are damaged: each is refused in one line, in little time and memory."""

import contextlib
import json
import os
import re
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib.resources import files
from pathlib import Path
from zipfile import ZIP_LZMA, ZipFile

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from quaffure import HairMaterial, InputError, load_groom
from quaffure.apps.character_table import read_table
from quaffure.apps.cli.inputs import body_shape_of
from quaffure.body import BodyModel, load_body
from quaffure.drape_motion import material_of
from quaffure.io import read_bvh, read_drape, read_groom, read_head, read_joint_map, read_usd_strands, write_groom
from quaffure.io.read_motion import read_motion
from quaffure.io.read_strands import STRAND_READERS, read_strands
from quaffure.model import load_network
from quaffure.model.quaffure_model import WEIGHTS
from quaffure.npz import read_numbers
from quaffure.procedural import make_groom, read_styles
from tests.synthetic_drape import drape, patch_of_strands
from tests.training_runs import tiny_groom

HOSTILE = Path(__file__).parents[2] / "shared" / "data" / "cases" / "hostile"
FAR_TOO_LONG = "a" * 5000


def peak_of(refused: Callable[[], object]) -> int:
    """Most memory that numpy and Python take until a file is refused [bytes]."""
    tracemalloc.start()
    with pytest.raises(InputError, match="in a file of its size"):
        refused()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def readers(body: BodyModel) -> dict[str, Callable[[Path], object]]:
    """By suffix, all that reads files of a user."""
    strands = {suffix: lambda path: load_groom(path, body) for suffix in STRAND_READERS}
    return {
        **strands,
        ".npz": lambda path: [load_groom(path, body)],
        ".obj": read_head,
        ".bvh": lambda path: read_motion(path, body),
        ".safetensors": load_network,
        ".csv": lambda path: body_shape_of(str(path)),
    }


@pytest.mark.skipif(not HOSTILE.is_dir(), reason=f"no {HOSTILE}: made for this project, not part of it")
@pytest.mark.parametrize("path", sorted(HOSTILE.glob("*")), ids=lambda path: path.name)
def test_files_that_once_raised_something_else_are_read_or_refused(path: Path, body: BodyModel) -> None:
    if path.suffix == ".npz":
        kinds: list[Callable[[Path], object]] = [
            read_drape,
            read_strands,
            lambda path: read_motion(path, body),
            lambda path: load_groom(path, body),
        ]
    else:
        kinds = [readers(body)[path.suffix]]
    for read in kinds:
        with contextlib.suppress(InputError):
            read(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs on this system")
@pytest.mark.parametrize("suffix", [*STRAND_READERS, ".obj", ".bvh", ".safetensors", ".csv"])
def test_a_pipe_is_refused_and_not_waited_for(suffix: str, tmp_path: Path, body: BodyModel) -> None:
    os.mkfifo(tmp_path / f"pipe{suffix}")
    with pytest.raises(InputError, match="found a pipe, socket or device"):
        readers(body)[suffix](tmp_path / f"pipe{suffix}")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no devices on this system")
def test_a_device_without_end_is_refused(tmp_path: Path, body: BodyModel) -> None:
    for name in ("zero.hair", "zero.npz", "zero.usda", "zero.ply", "zero.toml", "zero.csv"):
        (tmp_path / name).symlink_to("/dev/zero")
    of_zero: tuple[Callable[[], object], ...] = (
        *(partial(read_strands, tmp_path / f"zero.{suffix}") for suffix in ("hair", "npz", "usda", "ply")),
        lambda: read_head(tmp_path / "zero.ply"),
        lambda: read_joint_map(tmp_path / "zero.toml"),
        lambda: read_table(tmp_path / "zero.csv"),
    )
    for read in of_zero:
        with pytest.raises(InputError, match="found a pipe, socket or device"):
            read()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs on this system")
def test_other_readers_of_arrays_refuse_a_pipe(tmp_path: Path, body: BodyModel) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    for read in (read_drape, load_body, lambda path: read_groom(path, body), lambda path: read_motion(path, body)):
        with pytest.raises(InputError, match="found a pipe, socket or device"):
            read(tmp_path / "pipe.npz")


def test_a_name_longer_than_the_system_allows_is_refused(body: BodyModel) -> None:
    for name in (FAR_TOO_LONG, f"{FAR_TOO_LONG}.npz", f"{FAR_TOO_LONG}.hair", "nul\0.npz"):
        with pytest.raises(InputError):
            load_groom(name, body)


def test_zeros_that_deflate_well_are_refused_before_memory_is_taken(tmp_path: Path, body: BodyModel) -> None:
    np.savez_compressed(tmp_path / "strands.npz", strands=np.zeros((200_000, 16, 3), np.float32))
    np.savez_compressed(tmp_path / "clip.npz", poses=np.zeros((40_000, 66)), mocap_framerate=120.0)
    assert (tmp_path / "strands.npz").stat().st_size < 100_000
    assert peak_of(lambda: read_strands(tmp_path / "strands.npz")) < 1_000_000
    assert peak_of(lambda: read_motion(tmp_path / "clip.npz", body)) < 1_000_000


def test_a_motion_of_too_many_frames_is_refused(tmp_path: Path, body: BodyModel) -> None:
    np.savez_compressed(tmp_path / "clip.npz", poses=np.zeros((100_001, 66), np.float16), mocap_framerate=120.0)
    with pytest.raises(InputError, match="1 to 100000 frames"):
        read_motion(tmp_path / "clip.npz", body)


def test_products_beyond_single_precision_are_refused_without_a_warning(tmp_path: Path, body: BodyModel) -> None:
    write_groom(tmp_path / "far.npz", make_groom("crew_cut", body).select(torch.arange(0, 900, 90)))
    with np.load(tmp_path / "far.npz") as written:
        arrays = dict(written)
    arrays["rest_strands"][2, 5] = 1e25  # its square overflows
    np.savez(tmp_path / "far.npz", **arrays)
    with pytest.raises(InputError, match="m and inf m"):
        read_groom(tmp_path / "far.npz", body)
    with np.load(str(files("quaffure") / "assets" / "body.npz"), allow_pickle=False) as shipped:
        arrays = dict(shipped)
    arrays["shape_direction_scales"] = np.full_like(arrays["shape_direction_scales"], 1e38)
    np.savez(tmp_path / "body.npz", **arrays)
    with pytest.raises(InputError, match="shape directions within single precision"):
        load_body(tmp_path / "body.npz")


def test_members_that_numpy_does_not_write_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "plain.npz", strands=np.zeros((1, 2, 3)))
    with ZipFile(tmp_path / "plain.npz") as plain, ZipFile(tmp_path / "lzma.npz", "w", ZIP_LZMA) as packed:
        packed.writestr("strands.npy", plain.read("strands.npy"))
    content = bytearray((tmp_path / "plain.npz").read_bytes())
    content[content.index(b"PK\1\2") + 8] |= 1  # the flag of encryption
    (tmp_path / "encrypted.npz").write_bytes(content)
    for name in ("lzma.npz", "encrypted.npz"):
        with pytest.raises(InputError, match=r"as numpy\.savez writes them"):
            read_strands(tmp_path / name)
    # The directory of a zip of another version raises what is no BadZipFile.
    content[content.index(b"PK\1\2") + 6] = 255
    (tmp_path / "version.npz").write_bytes(content)
    with pytest.raises(InputError):
        load_groom(tmp_path / "version.npz")


def test_types_that_torch_lacks_are_refused_and_foreign_byte_order_is_read(tmp_path: Path, body: BodyModel) -> None:
    for name, kind in (("wide", np.longdouble), ("times", "m8[s]"), ("complex", np.complex64)):
        np.savez(tmp_path / f"{name}.npz", poses=np.zeros((2, 66), kind), mocap_framerate=30.0)
        with pytest.raises(InputError, match=re.escape(f"poses of type {np.dtype(kind)}, not plain numbers")):
            read_motion(tmp_path / f"{name}.npz", body)
    np.savez(tmp_path / "big.npz", body_pose=np.full((2, 81), 0.25, ">f4"), fps=np.array(30, ">i8"))
    assert read_motion(tmp_path / "big.npz", body).body_pose.eq(0.25).all()
    assert read_numbers(tmp_path / "big.npz", ("body_pose",))["body_pose"].dtype.isnative


def test_numbers_that_float32_cannot_hold_are_refused(tmp_path: Path) -> None:
    arrays = {**vars(drape(patch_of_strands((0.0, 1.0, 0.0)))), "meta": np.array("{}")}
    held = ("stiffness_scale", "goal_weight", "tie_vertex", "body_translation")
    arrays = {name: values for name, values in arrays.items() if name not in held}
    np.savez(tmp_path / "drape.npz", **arrays | {"posed": np.full(arrays["posed"].shape, 1e300)})
    with pytest.raises(InputError, match="finite posed"):
        read_drape(tmp_path / "drape.npz")


def nested(opening: str, closing: str, depth: int, before: str = "", after: str = "") -> str:
    return f"#usda 1.0\n{before}" + opening * depth + closing * depth + after


DOUBLING = "#usda 1.0\n" + "".join(
    f'def "L{i}" {{\n' + "".join(f'def "{side}" (references=</L{i - 1}>) {{\n}}\n' for side in "ab") + "}\n"
    if i
    else 'def "L0" {\n}\n'
    for i in range(40)
)
USD_TRAPS = {
    "dictionaries": nested("dictionary a = {\n", "}\n", 50_000, "(\ncustomLayerData = {\n", "}\n)\n"),
    "prims": nested('def "a" {\n', "}\n", 100_000),
    "a path": f'#usda 1.0\ndef "a" (references = </{"a/" * 100_000}b>) {{\n}}\n',
    "doubling references": DOUBLING,
}


@pytest.mark.parametrize("text", USD_TRAPS.values(), ids=USD_TRAPS.keys())
def test_usd_that_ends_or_fills_the_process_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "trap.usda").write_text(text)
    with pytest.raises(InputError, match=r"one (on which the USD library ends|that takes more)") as caught:
        read_usd_strands(tmp_path / "trap.usda")
    assert "\n" not in str(caught.value)


def test_usd_of_another_file_that_ends_the_process_is_refused(tmp_path: Path) -> None:
    (tmp_path / "deep.usda").write_text(USD_TRAPS["prims"])
    (tmp_path / "small.usda").write_text("#usda 1.0\n(\nsubLayers = [@./deep.usda@]\n)\n")
    with pytest.raises(InputError, match="the USD library ends"):
        read_usd_strands(tmp_path / "small.usda")


@pytest.mark.parametrize("rate", ["nan", "0"])
def test_usd_without_times_is_refused(rate: str, tmp_path: Path) -> None:
    curve = """def BasisCurves "A" {
        uniform token type = "linear"
        int[] curveVertexCounts = [2]
        point3f[] points.timeSamples = {1: [(0, 0, 0), (0, 0, 1)]}
    }"""
    for text, name in ((f"(timeCodesPerSecond = {rate})", "broken"), ("", "sound")):
        (tmp_path / f"{name}.usda").write_text(f"#usda 1.0\n{text}\n{curve}\n")
    assert len(read_usd_strands(tmp_path / "sound.usda")) == 1
    with pytest.raises(InputError, match="finite times of samples, found NaN or infinity"):
        read_usd_strands(tmp_path / "broken.usda")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs on this system")
@pytest.mark.parametrize("name", ["pipe.usda", "between.usda"])
def test_usd_of_a_pipe_is_refused_and_not_waited_for(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("quaffure.io.strand_process.WALL_TIME", 100.0)  # or the wait is refused by itself
    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "between.usda").write_text('#usda 1.0\ndef "a" (references = @./pipe.usda@) {}\n')
    (tmp_path / "top.usda").write_text(f"#usda 1.0\n(\nsubLayers = [@./{name}@]\n)\n")
    with pytest.raises(InputError, match="found a pipe, socket or device"):
        read_usd_strands(tmp_path / "top.usda")


def test_numbers_of_more_digits_than_python_converts(tmp_path: Path) -> None:
    digits = "9" * 5000
    head = "HIERARCHY\nROOT hip\n{\nOFFSET 0 0 0\n"
    for name, rest in (
        ("frames", f"CHANNELS 1 Xrotation\n}}\nMOTION\nFrames: {digits}\n"),
        ("channels", f"CHANNELS {digits} Xrotation\n"),
    ):
        (tmp_path / f"{name}.bvh").write_text(head + rest)
        with pytest.raises(InputError, match="line"):
            read_bvh(tmp_path / f"{name}.bvh")


def test_whole_numbers_of_an_obj_that_no_array_holds(tmp_path: Path) -> None:
    (tmp_path / "head.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {2**64}\n")
    with pytest.raises(InputError, match="numbers in the v and f lines"):
        read_head(tmp_path / "head.obj")


@pytest.mark.parametrize(
    "text", ["a." * 5_000 + "a = 1", "\n".join(f"a{number} = 1" for number in range(5_000))], ids=["deep", "long"]
)
def test_settings_that_take_the_readers_time_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(text)
    for read in (read_joint_map, read_styles):
        with pytest.raises(InputError, match="of at most 2000 lines and 200 characters a line, found"):
            read(tmp_path / "map.toml")


def test_weights_of_numbers_that_torch_does_not_convert(tmp_path: Path) -> None:
    header = json.dumps({"a": {"dtype": "F4", "shape": [8], "data_offsets": [0, 4]}}).encode()
    (tmp_path / "four.safetensors").write_bytes(len(header).to_bytes(8, "little") + header + bytes(4))
    with pytest.raises(InputError, match="expected a checkpoint"):
        load_network(tmp_path / "four.safetensors")


@pytest.mark.parametrize("code", [0xD800, 0x110000, 2**32 - 1])
def test_texts_of_arrays_that_are_no_characters(code: int, body: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "groom.npz"
    write_groom(path, tiny_groom(body))
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    np.savez(path, **(arrays | {"name": np.array([code], np.uint32).view("<U1").reshape(())}))
    with pytest.raises(InputError, match="with text as name, found codes of no characters"):
        read_groom(path, body)


def weights_with(path: Path, **changes: object) -> Path:
    """The shipped weights with another note."""
    with safe_open(WEIGHTS, framework="pt") as file:
        tensors, notes = {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata())  # noqa: SIM118
    save_file(tensors, path, notes | {name: json.dumps(value) for name, value in changes.items()})
    return path


MATERIAL = asdict(HairMaterial())


@pytest.mark.parametrize(
    ("note", "value", "found"),
    [
        ("material", MATERIAL | {"k_stretch": float("nan")}, "k_stretch"),
        ("material", MATERIAL | {"k_stretch": -1.0}, "k_stretch from 0 to 1e[+]12, found -1.0"),
        ("material", MATERIAL | {"k_stretch": "1"}, "k_stretch to be float, found '1'"),
        ("material", MATERIAL | {"k_stretch": 1e30}, "found 1e[+]30"),
        ("material", MATERIAL | {"linear_density": 0.0}, "linear_density"),
        ("material", MATERIAL | {"smoothing_length": True}, "smoothing_length to be float, found True"),
        ("material", [1], "no JSON object"),
        ("network", [1], "checkpoint"),
        ("network", {"initial_shape": {"layer_ramp": "wide"}}, "layer_ramp"),
        ("network", {"initial_shape": {"layer_thickness": float("inf")}}, "layer_thickness"),
        ("network", {"projection": {"spacing": 0.0}}, "a spacing above 0"),
        ("network", {"initial_shape": {"decay_length": -0.05}}, "no length, share or slope below 0"),
    ],
)
def test_settings_of_weights_are_checked(note: str, value: object, found: str, tmp_path: Path) -> None:
    path = weights_with(tmp_path / "weights.safetensors", **{note: value})
    with pytest.raises(InputError, match=found) as caught:
        load_network(path)
    assert str(path) in str(caught.value)


def test_material_of_a_drape_is_checked() -> None:
    seq = drape(patch_of_strands((0.0, 1.0, 0.0)))
    seq.meta["material"] = {"k_stretch": "much"}
    with pytest.raises(InputError, match="k_stretch"):
        material_of(seq)
