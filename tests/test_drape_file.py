import zipfile
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.io import read_drape, write_drape
from tests.synthetic_drape import drape, patch_of_strands

BACK = (0.0, 1.0, 0.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "drape.npz"
    write_drape(file, drape(patch_of_strands(BACK)))
    return file


def altered(path: Path, **changes: np.ndarray | None) -> Path:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


def test_round_trip_keeps_everything(path: Path) -> None:
    written, read = drape(patch_of_strands(BACK)), read_drape(path)
    for field in fields(written):
        first, second = getattr(written, field.name), getattr(read, field.name)
        np.testing.assert_array_equal(first, second, err_msg=field.name)
        assert getattr(first, "dtype", None) == getattr(second, "dtype", None)
    assert len(read) == 3


def test_file_is_plain_numpy(path: Path) -> None:
    with np.load(path, allow_pickle=False) as file:
        assert file["strands"].shape == (3, 150, 8, 3)
        assert str(file["meta"]) == '{"groom": "patch", "draper": "none"}'


def test_compressed_file_is_read_too(path: Path) -> None:
    with np.load(path) as file:
        np.savez_compressed(path.with_name("small.npz"), **{name: file[name] for name in file.files})
    np.testing.assert_array_equal(read_drape(path.with_name("small.npz")).strands, read_drape(path).strands)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"posed": None}, "no array posed"),
        ({"posed": np.zeros((2, 150, 8, 3), np.float32)}, r"posed of shape \(3, 150, 8, 3\)"),
        ({"rest_lengths": np.zeros((150, 8), np.float32)}, "a rest length for each segment"),
        ({"body_pose": np.zeros((3, 80), np.float32)}, r"body_pose of shape \(3, 81\)"),
        ({"body_shape": np.full(10, np.nan, np.float32)}, "finite body_shape"),
        ({"body_faces": np.array([[0, 1, 10**6]], np.int32)}, "body_faces within"),
        ({"body_faces": np.array([[0, 1, -1]], np.int32)}, "body_faces within"),
        ({"body_faces": np.zeros((1, 3), np.float32)}, "body_faces of type integer"),
        ({"strands": np.zeros((3, 150, 8, 3), complex)}, "strands of type floating or integer"),
        ({"fps": np.array(0.0)}, "a positive fps"),
        ({"meta": np.array("[1]")}, "a JSON object"),
        ({"meta": np.array(3)}, "meta of type str"),
        ({"meta": np.array("{")}, "a JSON object"),
    ],
)
def test_broken_file_is_named(path: Path, changes: dict[str, np.ndarray | None], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_drape(altered(path, **changes))
    assert str(path) in str(caught.value)


def test_pickle_is_not_opened(path: Path) -> None:
    with pytest.raises(InputError, match="posed of type floating"):
        read_drape(altered(path, posed=np.array([{}], dtype=object)))


def test_forged_size_is_refused_before_allocating(path: Path) -> None:
    header = BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (1 << 40,)})
    with np.load(path) as file, zipfile.ZipFile(path.with_name("forged.npz"), "w") as archive:
        for name in file.files:
            content = BytesIO()
            np.save(content, file[name])
            archive.writestr(f"{name}.npy", header.getvalue() if name == "posed" else content.getvalue())
    with pytest.raises(InputError, match=r"posed \[1099511627776\]"):
        read_drape(path.with_name("forged.npz"))


def test_what_is_no_archive(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not a zip")
    for name in ("text.npz", "missing.npz"):
        with pytest.raises(InputError, match="drape file"):
            read_drape(tmp_path / name)


def test_truncated_file(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match="drape file"):
        read_drape(path)


def test_bad_sequence_is_not_written(tmp_path: Path) -> None:
    broken = replace(drape(patch_of_strands(BACK)), body_shape=np.full(10, np.inf, np.float32))
    with pytest.raises(InputError, match="finite body_shape"):
        write_drape(tmp_path / "out.npz", broken)
    assert list(tmp_path.iterdir()) == []
