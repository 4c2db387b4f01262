"""Drapes are made frame by frame into files, and interrupted ones continue where they stopped, to the bit."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from quaffure import HairMaterial, InputError, load_groom
from quaffure.apps.cli import drape as drape_command
from quaffure.apps.cli import kept_frames
from quaffure.apps.cli.main import main
from quaffure.baselines import PosedDraper
from quaffure.body import BodyModel, bundled_clip
from quaffure.drape_motion import drape_motion
from quaffure.frame_store import BatchState, Frames, FramesInMemory
from quaffure.io import check_output, read_drape
from quaffure.io.frame_folder import FrameFolder
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper, solver
from tests.test_output_files import no_file_above

BATCH, TOTAL = 4, 10
RANDOM = np.random.default_rng(0)
WHOLE = Frames(*(RANDOM.random((TOTAL, *shape), np.float32) for shape in ((5, 3, 3), (5, 3, 3), (7, 3))))
STATE = RANDOM.random((5, 7), np.float32)


def batches() -> Iterator[Frames]:
    for first in range(0, TOTAL, BATCH):
        yield Frames(*(array[first : first + BATCH] for array in WHOLE))


def folder(path: Path, resume: bool, **changes: Any) -> FrameFolder:
    return FrameFolder(path, {"frames": TOTAL, "draper": "none", **changes}, BATCH, resume)


def filled(path: Path, count: int) -> FrameFolder:
    """A folder with some batches."""
    store = folder(path, resume=False)
    for number, batch in zip(range(count), batches()):
        store.append(batch, BatchState(float(number), STATE + number))
    return store


def test_files_of_others_in_a_folder_of_frames_stay(tmp_path: Path) -> None:
    photos, link = tmp_path / "photos", tmp_path / "link"
    photos.mkdir()
    link.symlink_to(photos)
    with pytest.raises(InputError, match=r"expected no folder of this name, .*, found a link"):
        folder(link, resume=False)
    (photos / "a.jpg").touch()
    with pytest.raises(InputError, match=r"expected no folder of this name, .*, found a\.jpg"):
        folder(photos, resume=False)
    assert [file.name for file in photos.iterdir()] == ["a.jpg"]
    store = filled(tmp_path / "frames", 1)
    (tmp_path / "frames/notes.txt").touch()
    store.discard()
    assert [file.name for file in (tmp_path / "frames").iterdir()] == ["notes.txt"]


def test_frames_are_kept(tmp_path: Path) -> None:
    store = filled(tmp_path / "frames", 3)
    with pytest.raises(InputError, match="expected an output that no other run is making"):
        folder(tmp_path / "frames", resume=True)
    assert (len(store), store.milliseconds) == (TOTAL, [0.0, 1.0, 2.0])
    for expected, found in zip(WHOLE, store.frames()):
        assert isinstance(found, np.memmap)
        np.testing.assert_array_equal(expected, found)
    store.close()
    again = folder(tmp_path / "frames", resume=True)
    assert (len(again), again.milliseconds) == (TOTAL, store.milliseconds)
    assert again.draper_state is not None
    np.testing.assert_array_equal(again.draper_state, STATE + 2)


@pytest.mark.parametrize("name", Frames._fields)
def test_what_a_killed_run_left_of_a_batch_is_cut_off(tmp_path: Path, name: str) -> None:
    """At any byte of any file of the second batch."""
    for lost in (1, 100):
        filled(tmp_path / "frames", 2).close()
        file = tmp_path / "frames" / f"{name}.f32"
        file.write_bytes(file.read_bytes()[:-lost])
        np.save(tmp_path / "frames" / "state-4.npy", STATE)  # removed after a batch is whole
        again = folder(tmp_path / "frames", resume=True)
        assert (len(again), again.milliseconds) == (BATCH, [0.0])
        assert again.draper_state is not None
        np.testing.assert_array_equal(again.draper_state, STATE)
        for number, batch in enumerate([*batches()][1:], 1):
            again.append(batch, BatchState(float(number)))
        for expected, found in zip(WHOLE, again.frames()):
            np.testing.assert_array_equal(expected, found)
        again.discard()


def test_other_settings_and_damage_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "frames"
    filled(path, 1).close()
    with pytest.raises(InputError, match=r"--resume: expected the settings of .*, found other draper"):
        folder(path, resume=True, draper="posed")
    (path / "settings.json").write_text("{")
    with pytest.raises(InputError, match="frames of an interrupted drape"):
        folder(path, resume=True)
    store = folder(path, resume=False)
    assert (len(store), store.holds_frames, (path / "strands.f32").exists()) == (0, True, True)  # until its first batch
    assert len(folder(tmp_path / "none", resume=True)) == 0


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C after the second batch."""
    add = drape_command.DrapeChecks.add
    count = 0

    def counted(*arguments: Any) -> None:
        nonlocal count
        count += 1
        if count == 2:
            raise KeyboardInterrupt
        add(*arguments)

    monkeypatch.setattr(drape_command.DrapeChecks, "add", counted)


def command(groom: Path, out: Path, *more: str) -> list[str]:
    options = ["--motion", "neck_turn", "--frames", "20:40", "--metrics", "--json"]
    return ["drape", str(groom), *options, "--out", str(out), *more]


@pytest.mark.usefixtures("interrupted")
def test_an_interrupted_drape_continues_to_the_bit(
    tiny_groom_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kept_frames, "KEPT_SECONDS", 0.0)
    out = tmp_path / "drape.npz"
    with pytest.raises(SystemExit) as stop:
        main(command(tiny_groom_file, out))
    assert stop.value.code == 130
    assert [path.name for path in tmp_path.iterdir()] == [".drape.npz.frames"]
    with pytest.raises(SystemExit):
        main(command(tiny_groom_file, out, "--resume", "--stiffness", "2"))
    assert "found other stiffness" in capfd.readouterr().err
    with pytest.raises(SystemExit):
        main(command(tiny_groom_file, out, "--resume", "--model", "quaffure"))
    assert "found other draper, model" in capfd.readouterr().err
    main(command(tiny_groom_file, out, "--resume"))
    resumed = json.loads(capfd.readouterr().out)
    assert [path.name for path in tmp_path.iterdir()] == ["drape.npz"]
    main(command(tiny_groom_file, tmp_path / "whole.npz"))
    whole = json.loads(capfd.readouterr().out)
    for name in ("strands", "posed", "body_vertices"):
        np.testing.assert_array_equal(*(getattr(read_drape(path), name) for path in (out, tmp_path / "whole.npz")))
    assert resumed["per_frame"] == whole["per_frame"]


@pytest.mark.usefixtures("interrupted")
def test_a_short_interrupted_drape_leaves_nothing(tiny_groom_file: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        main(command(tiny_groom_file, tmp_path / "drape.npz"))
    assert not list(tmp_path.iterdir())


DAMAGED_SETTINGS = {
    "nothing": "{}",
    "a list": "[]",
    "no settings": '{"settings": 3, "shapes": {}}',
    "no shapes": '{"settings": {}, "shapes": {}}',
    "shapes of text": '{"settings": {}, "shapes": {"strands": "5", "posed": [5, 3, 3], "body_vertices": [7, 3]}}',
    "a negative shape": '{"settings": {}, "shapes": {"strands": [-5, 3], "posed": [5, 3, 3], "body_vertices": [7, 3]}}',
    "no size": '{"settings": {}, "shapes": {"strands": [0, 3, 3], "posed": [5, 3, 3], "body_vertices": [7, 3]}}',
    "a number of digits": '{"settings": ' + "9" * 5000 + "}",
    "too deep": "[" * 100_000,
}


@pytest.mark.parametrize("whole", [True, False], ids=["frames", "no frames"])
@pytest.mark.parametrize("text", DAMAGED_SETTINGS.values(), ids=DAMAGED_SETTINGS.keys())
def test_damaged_settings_are_refused(text: str, whole: bool, tmp_path: Path) -> None:
    path = tmp_path / "frames"
    filled(path, int(whole)).close()
    (path / "settings.json").write_text(text)
    with pytest.raises(InputError, match="frames of an interrupted drape") as caught:
        folder(path, resume=True)
    assert "\n" not in str(caught.value)
    assert len(folder(path, resume=False)) == 0  # which is not locked


def test_a_shape_larger_than_the_files_is_refused_and_cuts_nothing_off(tmp_path: Path) -> None:
    path = tmp_path / "frames"
    filled(path, 1).close()
    settings = json.loads((path / "settings.json").read_text())
    settings["shapes"]["strands"] = [2**30, 2**30, 3]
    (path / "settings.json").write_text(json.dumps(settings))
    sizes = {file.name: file.stat().st_size for file in path.iterdir()}
    with pytest.raises(InputError, match="fewer bytes than those of a batch"):
        folder(path, resume=True)
    assert sizes == {file.name: file.stat().st_size for file in path.iterdir()}


def state_of(shape: str) -> bytes:
    """A file that says that it holds an array of this shape."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
    return b"\x93NUMPY\1\0v\0" + header + STATE.tobytes()


@pytest.mark.parametrize(
    "content",
    [b"", b"damaged", state_of("(4, 7)"), state_of("(35,)"), state_of("(5, -7)"), state_of(f"(5, {2**40})")],
    ids=["nothing", "text", "other strands", "no rows", "negative", "huge"],
)
def test_a_damaged_state_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "frames"
    filled(path, 1).close()
    (path / "state-4.npy").write_bytes(state_of("(5, 7)"))
    folder(path, resume=True).close()
    (path / "state-4.npy").write_bytes(content)
    with pytest.raises(InputError, match="frames of an interrupted drape"):
        folder(path, resume=True)


def test_kept_frames_of_other_strands_are_refused(tiny_groom_file: Path, body: BodyModel) -> None:
    groom, motion = load_groom(tiny_groom_file, body), bundled_clip("nod", body).select(slice(0, 2))
    store = FramesInMemory()
    drape_motion(PosedDraper(HairMaterial()), groom, body, motion, torch.zeros(10), store=store)
    fewer = groom.select(torch.arange(len(groom) - 1))
    with pytest.raises(InputError, match="frames of an interrupted drape: expected strands of shape"):
        drape_motion(PosedDraper(HairMaterial()), fewer, body, motion, torch.zeros(10), store=store)
    draper = CoherentDraper(solver("strand_newton"))
    with pytest.raises(InputError, match="state: expected numbers"):
        draper.resume(Scene(groom, BodyBatch(body, motion.body_pose, torch.zeros(2, 10))), torch.zeros(3, 7))


def test_a_disk_that_is_full_in_the_first_batch_leaves_nothing(
    tiny_groom_file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command = ["drape", str(tiny_groom_file), "--draper", "posed", "--motion", "nod", "--frames", "0:4"]
    with no_file_above(20_000), pytest.raises(SystemExit):
        main([*command, "--out", str(tmp_path / "drape.npz")])
    assert "a folder for frames that can be written" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


def test_frames_of_an_earlier_run_stay_until_a_batch_replaces_them(tmp_path: Path) -> None:
    filled(tmp_path / "frames", 1).close()
    store = folder(tmp_path / "frames", resume=False)
    assert store.holds_frames
    with no_file_above(100), pytest.raises(InputError, match="can be written"):
        store.append(next(batches()), BatchState(0.0))
    assert not store.holds_frames


def test_folders_of_killed_runs_without_a_batch_are_swept_and_others_are_not(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from pathlib import Path; from tests.test_long_drapes import filled, folder\n"
        "path = Path(sys.argv[1])\n"
        "for name, count in ((f'.{count}.frames', count) for count in (0, 1)): filled(path / name, count)\n"
        "store = folder(path / '.half.frames', resume=False)\n"
        "store._extend = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "from tests.test_long_drapes import batches, BatchState\n"
        "store.append(next(batches()), BatchState(0.0))"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=False, env=environment)
    assert ended.returncode == -9
    living = folder(tmp_path / ".living.frames", resume=False)
    for name, file in ((".damaged.frames", "settings.json"), (".foreign.frames", "film.mov")):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).touch()
    assert (tmp_path / ".half.frames" / "settings.json").exists()
    check_output(tmp_path / "other.npz", ".npz")
    left = {".1.frames", ".living.frames", ".damaged.frames", ".foreign.frames"}
    assert {path.name for path in tmp_path.iterdir()} == left
    living.close()
