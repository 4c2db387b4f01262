import json
from importlib.metadata import version
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import pytest
import torch

from quaffure import InputError
from quaffure.training import RunFolder


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder(tmp_path / "runs" / "first")


def test_a_checkpoint_comes_back_for_the_same_run_alone(folder: RunFolder) -> None:
    assert folder.load({"identity": "bob, seed 0"}) is None
    folder.save({"identity": "bob, seed 0", "weights": torch.arange(3.0)})
    state = folder.load({"identity": "bob, seed 0"})
    assert state is not None
    assert torch.equal(state["weights"], torch.arange(3.0))
    with pytest.raises(InputError, match=r"expected a run of bob, seed 1, found bob, seed 0"):
        folder.load({"identity": "bob, seed 1"})


def test_damaged_and_foreign_checkpoints_are_refused(folder: RunFolder) -> None:
    path = folder.path / "checkpoint.pt"
    folder.save({"identity": "bob", "weights": torch.arange(1000.0)})
    whole = path.read_bytes()
    for damaged in (b"", b"PK\x03\x04 cut short", whole[: len(whole) // 2], whole[200:], b"junk"):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"checkpoint\.pt: expected a checkpoint of this training"):
            folder.load({"identity": "bob"})
    torch.save(Path("not a tensor"), path)  # would have to be unpickled
    with pytest.raises(InputError, match="checkpoint of this training"):
        folder.load({"identity": "bob"})
    folder.save({"weights": torch.arange(3.0), "identity": "bob"})
    with pytest.raises(InputError, match="checkpoint of this training"), folder.reading():
        torch.nn.Linear(2, 2).load_state_dict({"other": torch.zeros(1)})


def test_a_checkpoint_that_unpacks_to_more_than_its_size_is_refused(folder: RunFolder) -> None:
    path = folder.path / "checkpoint.pt"
    folder.save({"identity": "bob", "weights": torch.zeros(1_000_000)})
    with ZipFile(path) as plain:
        parts = {name: plain.read(name) for name in plain.namelist()}
    with ZipFile(path, "w", ZIP_DEFLATED) as packed:
        for name, content in parts.items():
            packed.writestr(name, content)
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match=r"uncompressed as torch\.save writes it, found 400"):
        folder.load({"identity": "bob"})


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_checkpoints_of_numbers_that_are_not_finite_are_refused(folder: RunFolder, number: float) -> None:
    folder.save({"identity": "bob", "optimizer": {"state": [{"average": torch.tensor([1.0, number])}]}})
    with pytest.raises(InputError, match="NaN or infinity"):
        folder.load({"identity": "bob"})
    folder.save({"identity": "bob", "counters": torch.tensor([0.0, number, 0.0]), "steps": torch.arange(2)})
    assert folder.load({"identity": "bob"}) is not None  # no score so far


def test_rows_with_surplus_values_are_dropped(folder: RunFolder) -> None:
    path = folder.path / "training.csv"
    path.write_text("step,loss\n1,0.5\n1,0.3,4\n")
    folder.rewind_logs(1)
    assert path.read_text().split() == ["step,loss", "1,0.5"]


def test_logs_go_back_to_the_step_of_the_checkpoint(folder: RunFolder) -> None:
    for step in (2, 4, 6):
        folder.log("training", {"step": step, "loss": 1 / step})
    path = folder.path / "training.csv"
    with path.open("a") as file:
        file.write("8")  # cut short
    folder.rewind_logs(4)
    assert path.read_text().split() == ["step,loss", "2,0.5", "4,0.25"]
    folder.log("training", {"step": 5, "loss": 0.2})
    folder.rewind_logs(5)
    assert path.read_text().split()[1:] == ["2,0.5", "4,0.25", "5,0.2"]


def test_tables_of_the_users_are_left_alone(folder: RunFolder) -> None:
    own = folder.path / "measured.csv"
    own.write_text("name,length\nbob,0.2\n")
    folder.log("validation", {"step": 2, "energy": 0.5})
    folder.rewind_logs(0)
    assert own.read_text() == "name,length\nbob,0.2\n"
    assert (folder.path / "validation.csv").read_text().split() == ["step,energy"]


def test_a_table_of_an_older_version_takes_new_columns(folder: RunFolder) -> None:
    folder.log("validation", {"step": 1, "energy": 0.5})
    folder.log("validation", {"step": 2, "energy": 0.4, "body_intersection_percent": 3.0})
    folder.log("validation", {"step": 3, "body_intersection_percent": 2.0})
    rows = (folder.path / "validation.csv").read_text().split()
    assert rows == ["step,energy,body_intersection_percent", "1,0.5,", "2,0.4,3.0", "3,,2.0"]


def test_the_version_of_the_code_is_kept(folder: RunFolder) -> None:
    folder.describe({"config": {"steps": 3}})
    written = json.loads((folder.path / "config.json").read_text())
    assert written["config"] == {"steps": 3}
    assert written["version"].startswith(version("quaffure"))


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(InputError, match="folder for the run"):
            RunFolder(path)


def test_two_processes_do_not_train_in_one_folder(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    with (
        folder.locked(),
        pytest.raises(InputError, match="a folder that no other training uses"),
        RunFolder(tmp_path).locked(),
    ):
        pass
    with RunFolder(tmp_path).locked():
        pass
