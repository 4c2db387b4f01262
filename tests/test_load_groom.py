from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import InputError, load_groom
from quaffure.body import BodyModel, load_body
from quaffure.hair import FileFrame, Groom, HeadMesh, Strands
from quaffure.io import read_groom, read_head, write_groom
from quaffure.io.groom_file import NUMBERS, is_groom_file
from quaffure.procedural import make_groom
from tests.scenes import Registered

SINTEL = Path("grooms/sintel/sintel_hair_16points.tfx")


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom("bob", body)


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as file:
        return dict(file)


def test_bundled_names(groom: Groom, body: BodyModel) -> None:
    assert torch.equal(load_groom("bob", body).rest_strands, groom.rest_strands)


def test_groom_files_come_back_exactly(tmp_path: Path, groom: Groom, body: BodyModel) -> None:
    path = tmp_path / "saved.npz"
    write_groom(path, groom)
    assert is_groom_file(path)
    again = load_groom(path, body)
    assert (again.name, again.licence) == (groom.name, groom.licence)
    for name in NUMBERS:
        assert torch.equal(getattr(again, name), getattr(groom, name))


def test_strand_files_are_registered_and_thinned_to_one_strand_a_texel(
    tmp_path: Path, groom: Groom, body: BodyModel
) -> None:
    path = tmp_path / "wild.npz"
    points = 100 * groom.rest_strands.repeat(2, 1, 1)[:, ::2].reshape(-1, 3).numpy()
    np.savez(path, points=points, counts=np.full(2 * len(groom), 12))
    assert not is_groom_file(path)
    loaded = load_groom(str(path), body)
    assert loaded.name == "wild"
    assert loaded.rest_strands.shape[1:] == (24, 3)
    assert len(loaded) == loaded.texels().unique().numel()
    assert 0.85 * len(groom) < len(loaded) <= len(groom)
    assert loaded.strand_lengths.median() == pytest.approx(groom.strand_lengths.median().item(), rel=0.05)


DAMAGE = {
    "of shape": lambda a: {"rest_strands": a["rest_strands"][:-1]},
    "finite rest_strands": lambda a: {"rest_strands": np.where(a["rest_strands"] > 1.8, np.nan, a["rest_strands"])},
    "scalp": lambda a: {"root_faces": a["root_faces"] * 0 + 1},
    "sum to 1": lambda a: {"root_barycentric": 2 * a["root_barycentric"]},
    "unit square": lambda a: {"root_uv": a["root_uv"] + 1},
    "name": lambda a: {"name": np.array(3.0)},
    "24 vertices": lambda a: {"rest_strands": a["rest_strands"][:, :12]},
}


@pytest.mark.parametrize("expected", sorted(DAMAGE))
def test_contradictory_groom_files_are_refused(expected: str, tmp_path: Path, groom: Groom, body: BodyModel) -> None:
    path = tmp_path / "bad.npz"
    write_groom(path, groom)
    arrays = arrays_of(path)
    if expected == "scalp":
        assert 1 not in body.scalp.faces
    np.savez(path, **{**arrays, **DAMAGE[expected](arrays)})
    with pytest.raises(InputError, match=expected):
        load_groom(path, body)


def test_damaged_groom_files_are_refused(tmp_path: Path, groom: Groom, body: BodyModel) -> None:
    path = tmp_path / "bad.npz"
    write_groom(path, groom)
    content = path.read_bytes()
    for end in (0, 10, 1000, len(content) - 1):
        path.write_bytes(content[:end])
        with pytest.raises(InputError):
            read_groom(path, body)
    np.savez(path, rest_strands=np.zeros((1, 2, 3)))
    with pytest.raises(InputError, match="root_faces"):
        read_groom(path, body)
    write_groom(path, groom)
    np.savez(path, **{**arrays_of(path), "name": np.array([{}], dtype=object)})
    with pytest.raises(InputError, match="with name of type str, found object"):
        read_groom(path, body)


def test_unknown_names_and_files_are_refused(tmp_path: Path, body: BodyModel) -> None:
    with pytest.raises(InputError, match="long_straight"):
        load_groom("beehive", body)
    with pytest.raises(InputError, match="no such file"):
        load_groom(tmp_path / "missing.npz", body)
    other = tmp_path / "hair.txt"
    other.touch()
    with pytest.raises(InputError, match="suffix"):
        load_groom(other, body)


def test_head_meshes_are_read_and_checked(tmp_path: Path) -> None:
    path = tmp_path / "head.obj"
    path.write_text("o head\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 1\nv 0 1 0\nf 1/1/1 2/2/2 3/3/3 4/4/4\nf -4 -3 -2\n")
    head = read_head(path)
    assert head.vertices.shape == (4, 3)
    assert head.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    for content in ("", "v 0 0 0\nf 1 2 3\n", "v 0 0 x\n", "v 0 0 nan\nv 0 0 0\nv 0 1 0\nf 1 2 3\n"):
        path.write_text(content)
        with pytest.raises(InputError):
            read_head(path)
    with pytest.raises(InputError):
        read_head(tmp_path / "none.obj")
    with pytest.raises(InputError, match=r"a head mesh .* found suffix '\.fbx'"):
        read_head(tmp_path / "head.fbx")


@pytest.mark.slow
@pytest.mark.shared_data
def test_sintel_loads_with_and_without_its_head(
    shared_data: Path, body: BodyModel, registered: Registered, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its registration, which takes seconds, is shared with other tests."""
    folder, handed = shared_data / SINTEL.parent, []

    def shared(strands: Strands, onto: BodyModel, name: str, head: HeadMesh | None, frame: FileFrame):
        handed.append((len(strands), name, head is not None, frame == FileFrame()))
        assert onto is body
        return registered(str(SINTEL), head=str(SINTEL.with_name("sintel_head.obj")) if head else "")

    monkeypatch.setattr("quaffure.io.load_groom.register_groom", shared)
    for head in (None, folder / "sintel_head.obj"):
        sintel = load_groom(shared_data / SINTEL, body, head)
        assert sintel.name == SINTEL.stem
        assert sintel.rest_strands.shape[1:] == (24, 3)
        assert 2000 < len(sintel) == sintel.texels().unique().numel()
    (count, *_), _ = handed
    assert count > 11300
    assert handed == [(count, SINTEL.stem, with_head, True) for with_head in (False, True)]
