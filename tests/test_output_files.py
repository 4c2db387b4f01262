"""Output files: whole or not at all, checked before the work, and nothing left behind."""

import gc
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import FrameType
from zipfile import ZipFile

import numpy as np
import pytest
import torch
from PIL import Image

from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.apps.cli.outputs import write_output
from quaffure.apps.render import encode_video
from quaffure.apps.render.pictures import save_png
from quaffure.hair import ExportClip, ExportSettings
from quaffure.io import atomic, check_output, replacing, write_drape, write_glb, write_hair, write_ply, write_usd
from quaffure.io.atomic import replacing_together
from quaffure.io.counted_writer import write_ct2hair, write_hairsalon
from quaffure.io.output_path import check_output_folder, made_folder
from quaffure.io.temporary_file import HOST, OLDEST, PREFIX
from quaffure.model.weights_file import save_weights
from quaffure.training import RunFolder
from quaffure.training.run_folder import code_version
from tests.synthetic_drape import drape, patch_of_strands

SEQUENCE = drape(patch_of_strands((0.0, 1.0, 0.0)))
code_version()  # is kept from here on: git would run under the limit of `no_file_above`, too
NOISE = np.random.default_rng(0).integers(0, 255, (256, 256, 3), dtype=np.uint8)


def save_checkpoint(path: Path) -> None:
    RunFolder(path.parent).save({"identity": "bob", "weights": torch.randn(30_000)})


def save_half(path: Path) -> None:
    with replacing(path) as temporary:
        save_weights(temporary, torch.nn.Linear(200, 200), {})


def write_alembic(path: Path) -> None:
    pytest.importorskip("alembic3d")
    from quaffure.io.alembic_groom import write_groom_cache

    write_groom_cache(path, ExportClip(SEQUENCE))


WRITERS: dict[str, Callable[[Path], None]] = {
    "drape.npz": lambda path: write_drape(path, SEQUENCE),
    "drape.usd": lambda path: write_usd(path, SEQUENCE),
    "drape.usda": lambda path: write_usd(path, SEQUENCE),
    "drape.usdc": lambda path: write_usd(path, SEQUENCE),
    "drape.abc": write_alembic,
    "drape.glb": lambda path: write_glb(path, ExportClip(SEQUENCE)),
    "drape.ply": lambda path: write_ply(path, ExportClip(drape(SEQUENCE.strands[0], frames=1))),
    "drape.hair": lambda path: write_hair(path, ExportClip(drape(np.repeat(SEQUENCE.strands[0], 2, axis=0), 1))),
    "drape.data": lambda path: write_hairsalon(path, ExportClip(drape(np.repeat(SEQUENCE.strands[0], 3, axis=0), 1))),
    "drape.bin": lambda path: write_ct2hair(path, ExportClip(drape(np.repeat(SEQUENCE.strands[0], 2, axis=0), 1))),
    "drape.png": lambda path: save_png(path, Image.fromarray(NOISE)),
    "drape.mp4": lambda path: encode_video(path, [NOISE] * 9, 30.0),
    "results.json": lambda path: atomic.write_json(path, list(range(20_000))),
    "best.safetensors": save_half,
    "checkpoint.pt": save_checkpoint,
}
every_writer = pytest.mark.parametrize(("name", "write"), WRITERS.items(), ids=WRITERS.keys())


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """As on a full disk: writing beyond `size` [bytes] fails."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@every_writer
def test_a_full_disk_is_one_line_and_keeps_the_old_file(name: str, write: Callable, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"before")
    with no_file_above(20_000), pytest.raises(InputError, match=f"{name}: expected a file that can be written"):
        write(tmp_path / name)
    assert (tmp_path / name).read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_full_disk_in_a_training_is_one_line(tmp_path: Path) -> None:
    folder, row = RunFolder(tmp_path), {"step": 1, "loss": 0.5}
    folder.log("training", row)
    with no_file_above(20), pytest.raises(InputError, match=r"training\.csv: expected a file that can be written"):
        folder.log("training", row)


@every_writer
def test_a_symbolic_link_is_followed(name: str, write: Callable, tmp_path: Path) -> None:
    for folder in ("elsewhere", "here"):
        (tmp_path / folder).mkdir()
    link, target = tmp_path / "here" / name, tmp_path / "elsewhere" / "target"
    link.symlink_to(target)
    for _ in range(2):  # to nothing, then to a file
        write(link)
        assert link.is_symlink()
        assert target.stat().st_size > 100
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["target"]


def test_a_link_into_a_missing_folder_and_a_pipe_are_refused(tmp_path: Path) -> None:
    (tmp_path / "link.npz").symlink_to(tmp_path / "none" / "drape.npz")
    os.mkfifo(tmp_path / "pipe.npz")
    for name, found in (("link.npz", "no folder"), ("pipe.npz", "a pipe, socket or device")):
        for refused in (lambda path: check_output(path, ".npz"), lambda path: write_drape(path, SEQUENCE)):
            with pytest.raises(InputError, match=found):
                refused(tmp_path / name)


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc, the folder that not even root may write into")
def test_a_read_only_folder_is_found_before_the_work() -> None:
    for refused in (
        lambda: check_output(Path("/proc/drape.npz"), ".npz"),
        lambda: check_output_folder(Path("/proc/runs/first"), "a folder for the run"),
        lambda: made_folder(Path("/proc"), "a folder for the run"),
        lambda: write_drape(Path("/proc/drape.npz"), SEQUENCE),
    ):
        with pytest.raises(InputError, match="a writable folder"):
            refused()


def test_commands_refuse_a_read_only_folder_before_the_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    for command in (
        ["drape", "none.npz", "--out", f"{tmp_path}/out.npz"],
        ["groom", "import", "none.npz", "--out", f"{tmp_path}/out.npz"],
        ["train", "--groom", "none.npz", "--out", f"{tmp_path}/run"],
        ["train-code", "--groom", "none.npz", "--out", f"{tmp_path}/run"],
        ["groomgen-data", "--groom", "none.npz", "--out", f"{tmp_path}/run"],
        ["train-groomgen", "none", "--out", f"{tmp_path}/run"],
        ["evaluate", "--groom", "none.npz", "--out", f"{tmp_path}/out.json"],
        ["benchmark", "solvers", "--groom", "none.npz", "--out", f"{tmp_path}/out.json"],
        ["view", "none.npz", "--folder", f"{tmp_path}"],
    ):
        assert "expected a writable folder, found Permission denied" in refusal_of(command)


def refusal_of(command: list[str]) -> str:
    """The one line of a command that ends with 2."""
    stream, errors = sys.stderr, []
    sys.stderr = type("Stream", (), {"write": lambda _, text: errors.append(text), "flush": lambda _: None})()
    try:
        with pytest.raises(SystemExit) as stop:
            main(command)
    finally:
        sys.stderr = stream
    assert stop.value.code == 2, errors
    text = "".join(errors)
    assert text.count("\n") == 1
    return text


COMMANDS_WITH_INPUTS = {
    "drape groom": ["drape", "IN.npz", "--out", "OUT.npz"],
    "drape reference": ["drape", "bob", "--reference", "IN.npz", "--out", "OUT.npz"],
    "drape motion": ["drape", "bob", "--motion", "IN.npz", "--out", "OUT.npz"],
    "drape shape": ["drape", "bob", "--shape", "IN.npz", "--out", "OUT.npz"],
    "render": ["render", "IN.npz", "--out", "OUT.npz"],
    "import": ["groom", "import", "IN.npz", "--out", "OUT.npz"],
    "hold": ["groom", "hold", "IN.npz", "--length", "0.1", "--out", "OUT.npz"],
    "evaluate": ["evaluate", "--motion", "IN.json", "--out", "OUT.json"],
    "evaluate weights": ["evaluate", "--weights", "own=IN.json", "--out", "OUT.json"],
    "benchmark": ["benchmark", "inference", "--groom", "IN.json", "--out", "OUT.json"],
    "train": ["train", "--groom", "bob", "--weights", "IN/best.safetensors", "--out", "OUT"],
    "train-code": ["train-code", "--keep-encoder", "IN/groom_autoencoder.safetensors", "--out", "OUT"],
}


@pytest.mark.parametrize("command", COMMANDS_WITH_INPUTS.values(), ids=COMMANDS_WITH_INPUTS.keys())
def test_an_output_that_is_an_input_is_refused(command: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "real"
    folder.mkdir()
    (tmp_path / "link").symlink_to(folder)
    for name in ("file.npz", "file.json", "best.safetensors", "groom_autoencoder.safetensors"):
        (folder / name).write_bytes(b"precious")
    names = {"IN": str(folder / "file"), "OUT": str(tmp_path / "link" / "file")}
    if command[0].startswith("train"):
        names = {"IN": str(folder), "OUT": str(tmp_path / "link")}
    words = [word.replace("IN", names["IN"]).replace("OUT", names["OUT"]) for word in command]
    assert "expected an output that is none of the inputs" in refusal_of(words)
    assert (folder / "file.npz").read_bytes() == b"precious"


USD_NAMES = {
    "sublayer": "(\nsubLayers = [@./OUT.usda@]\n)\n",
    "sublayer of a sublayer": "(\nsubLayers = [@./between.usda@]\n)\n",
    "search path": "(\nsubLayers = [@OUT.usda@]\n)\n",
    "reference": 'def "A" (references = @./OUT.usda@) {}\n',
    "payload": 'def "A" (payload = @./OUT.usda@</A>) {}\n',
    "value clip": 'def "A" (clips = {dictionary default = {asset[] assetPaths = [@./OUT.usda@]}}) {}\n',
    "texture": 'def "A" {\nasset file = @./OUT.png@\n}\n',
}


@pytest.mark.parametrize("text", USD_NAMES.values(), ids=USD_NAMES.keys())
def test_an_output_that_a_usd_input_names_is_refused(text: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "top.usda").write_text(f"#usda 1.0\n{text}")
    (tmp_path / "between.usda").write_text('#usda 1.0\ndef "A" (payload = @./OUT.usda@) {}\n')
    for name in ("OUT.usda", "OUT.png"):
        (tmp_path / name).write_text("#usda 1.0\n")
    (tmp_path / "link").symlink_to(tmp_path)
    suffix = ".png" if "png" in text else ".usda"
    command = ["drape", str(tmp_path / "top.usda"), "--draper", "posed", "--out", f"{tmp_path}/link/OUT{suffix}"]
    assert f"found a file that the input {tmp_path}/top.usda names" in refusal_of(command)
    assert (tmp_path / f"OUT{suffix}").read_text() == "#usda 1.0\n"
    check_output(tmp_path / "between.npz", ".npz", inputs=[tmp_path / "top.usda"])


@pytest.mark.parametrize("name", ["walk arm.bin", "skin.png"])
def test_an_output_that_a_gltf_input_names_is_refused(name: str, tmp_path: Path) -> None:
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "data:;base64,AAAA"}, {"uri": "walk%20arm.bin", "byteLength": 8}],
        "images": [{"uri": "skin.png"}],
    }
    (tmp_path / "walk.gltf").write_text(json.dumps(document))
    (tmp_path / name).write_bytes(b"precious")
    command = ["drape", "bob", "--motion", f"{tmp_path}/walk.gltf#0", "--out", f"{tmp_path}/{name}"]
    assert f"found a file that the input {tmp_path}/walk.gltf#0 names" in refusal_of(command)
    (tmp_path / name).unlink()
    check_output(tmp_path / name, ".bin", ".png", inputs=[tmp_path / "walk.gltf"])  # a new file replaces nothing


def test_a_row_of_a_table_does_not_replace_what_another_reads(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(
        f"groom,motion,out\n{tmp_path}/a.npz,nod,{tmp_path}/b.npz\nbob,nod,{tmp_path}/a.npz\n"
    )
    assert "found the input" in refusal_of(["crowd", str(tmp_path / "table.csv")])


def test_one_file_twice_is_refused(tmp_path: Path) -> None:
    paths = [f"{tmp_path}/drape.npz", f"{tmp_path}/./drape.npz"]
    assert "the same file twice" in refusal_of(["drape", "bob", "--out", paths[0], "--out", paths[1]])


INTERRUPTED = ("replacing", "replacing_together", "_interrupts", "_synchronise")


def test_an_interrupt_at_any_line_of_a_write_leaves_nothing(tmp_path: Path) -> None:
    """Ctrl-C in every line of `replacing` in turn, until one write ends without having been interrupted."""
    lines = 0

    def interrupting(at: int) -> Callable:
        count = 0

        def trace(frame: FrameType, event: str, _: object) -> Callable | None:
            nonlocal count
            if frame.f_code.co_filename != atomic.__file__ or frame.f_code.co_name not in INTERRUPTED:
                return None
            # What Python promises of a `finally` that is itself interrupted is nothing.
            if event == "line" and "unlink" not in source[frame.f_lineno - 1]:
                count += 1
                if count == at:
                    raise KeyboardInterrupt
            return trace

        return trace

    source = Path(atomic.__file__).read_text().splitlines()
    before = sys.gettrace()
    for at in range(1, 200):
        sys.settrace(interrupting(at))
        try:
            with replacing(tmp_path / "drape.usda") as temporary:
                temporary.write_bytes(b"#usda 1.0")
        except KeyboardInterrupt:
            lines += 1
        else:
            break
        finally:
            sys.settrace(before)
        assert {path.name for path in tmp_path.iterdir()} <= {"drape.usda"}
    assert lines > 8


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_of_an_npz_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of which zipfile makes a ValueError, when numpy closes it with a member open."""

    def opened(archive: ZipFile, *arguments: object, **named: object) -> None:
        held.append(open_member(archive, *arguments, **named))  # type: ignore[arg-type]
        raise KeyboardInterrupt

    held, open_member = list[object](), ZipFile.open
    with monkeypatch.context() as patched:
        patched.setattr(ZipFile, "open", opened)
        with pytest.raises(KeyboardInterrupt):
            write_drape(tmp_path / "drape.npz", SEQUENCE)
    assert not list(tmp_path.iterdir())
    held.clear()
    gc.collect()  # the archive complains when it is collected, else in a later test


def test_a_full_disk_after_an_interrupt_is_none(tmp_path: Path) -> None:
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        with no_file_above(20_000), pytest.raises(InputError, match="can be written"):
            write_drape(tmp_path / "drape.npz", SEQUENCE)


def write_layers(path: Path) -> None:
    write_usd(path, ExportClip(SEQUENCE, settings=ExportSettings(frames_per_layer=1)))


def write_alembic_files(path: Path) -> None:
    pytest.importorskip("alembic3d")
    write_output(path, ExportClip(SEQUENCE))


def write_networks(path: Path) -> None:
    with replacing_together(path, path.with_name("other.safetensors")) as (one, other):
        save_weights(one, torch.nn.Linear(2, 2), {})
        save_weights(other, torch.nn.Linear(200, 200), {})


OF_SEVERAL_FILES = {"drape.usd": write_layers, "drape.abc": write_alembic_files, "best.safetensors": write_networks}


@pytest.mark.parametrize(("name", "write"), OF_SEVERAL_FILES.items(), ids=OF_SEVERAL_FILES.keys())
@pytest.mark.parametrize("at", ["write", "synchronise"])
def test_files_that_belong_together_appear_together(
    name: str, write: Callable, at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a disk that is full at the last of them."""
    (tmp_path / name).write_bytes(b"before")
    synchronised, synchronise = 0, os.fsync

    def full(descriptor: int) -> None:
        nonlocal synchronised
        synchronised += 1
        if synchronised == 2:
            raise OSError(28, "No space left on device")
        synchronise(descriptor)

    if at == "synchronise":
        monkeypatch.setattr(os, "fsync", full)
    with no_file_above(20_000) if at == "write" else nullcontext(), pytest.raises(InputError, match="can be written"):
        write(tmp_path / name)
    assert (tmp_path / name).read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_files_of_a_killed_process_are_swept_and_others_are_not(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from pathlib import Path; from quaffure.io.atomic import replacing\n"
        "with replacing(Path(sys.argv[1])) as path: path.write_bytes(b'half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "drape.usda")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run(command, check=False, env=environment).returncode == -9
    (left,) = tmp_path.iterdir()
    ours = tmp_path / f"{PREFIX}{HOST}-{os.getpid()}-00000000.npz"
    foreign, foreign_old = (tmp_path / f"{PREFIX}{name}-1-00000000.npz" for name in ("elsewhere", "elsewhere_old"))
    own = tmp_path / ".quaffure-notes.npz"
    for path in (ours, foreign, foreign_old, own):
        path.touch()
    os.utime(foreign_old, (0, os.stat(foreign_old).st_mtime - OLDEST - 60))
    check_output(tmp_path / "other.npz", ".npz")
    assert not left.exists()
    assert {path.name for path in tmp_path.iterdir()} == {ours.name, foreign.name, own.name}


def test_bytes_are_on_the_disk_before_the_name_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []
    synchronise, rename = os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: (events.append("fsync"), synchronise(descriptor))[1])
    monkeypatch.setattr(Path, "replace", lambda path, to: (events.append("rename"), rename(path, to))[1])
    write_drape(tmp_path / "drape.npz", SEQUENCE)
    assert events == ["fsync", "rename", "fsync"]


def test_processes_that_write_one_file_at_once_leave_it_whole(tmp_path: Path) -> None:
    several = [replace(SEQUENCE, fps=float(fps)) for fps in (24, 25, 30)]
    threads = [threading.Thread(target=write_drape, args=(tmp_path / "drape.npz", seq)) for seq in several]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [path.name for path in tmp_path.iterdir()] == ["drape.npz"]


def test_a_file_is_written_with_the_mode_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_drape(tmp_path / "drape.npz", SEQUENCE)
    assert (tmp_path / "drape.npz").stat().st_mode == (tmp_path / "plain").stat().st_mode
