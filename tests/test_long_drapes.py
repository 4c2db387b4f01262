"""Drapes are made frame by frame into files, and interrupted ones continue where they stopped, to the bit."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quaffure.apps.cli import drape as drape_command
from quaffure.apps.cli import kept_frames
from quaffure.apps.cli.main import main
from quaffure.errors import InputError
from quaffure.frame_store import BatchState, Frames
from quaffure.io import read_drape
from quaffure.io.frame_folder import FrameFolder

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
    assert again.follows is not None
    np.testing.assert_array_equal(again.follows, STATE + 2)


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
        assert again.follows is not None
        np.testing.assert_array_equal(again.follows, STATE)
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
