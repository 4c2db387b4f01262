"""What small glTF files may take of the memory: it is checked before it is taken."""

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quaffure import InputError
from quaffure.body import Character
from quaffure.io.gltf_document import MOST_COMPRESSION, open_gltf
from quaffure.io.read_character import read_character
from tests.gltf_files import GltfFile


def read(file: GltfFile, folder: Path) -> Character:
    path = folder / "file.glb"
    path.write_bytes(file.glb())
    return read_character(path)


def on_a_node(file: GltfFile, **primitive: Any) -> GltfFile:
    """A mesh of the first accessor."""
    file.add("meshes", primitives=[{"attributes": {"POSITION": 0}, "mode": 5, **primitive}])
    file.add("nodes", mesh=0)
    return file


def test_memory_is_checked_before_it_is_taken(tmp_path: Path) -> None:
    """Zeros without bytes in the file, and one array on many nodes."""
    zeros = GltfFile()
    zeros.add("accessors", count=2**31 - 1, componentType=5126, type="VEC3")
    many = on_a_node(zeros)
    tracemalloc.start()
    with pytest.raises(InputError, match="arrays that fit in a file of its size"):
        read(many, tmp_path)
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()
    many.document["accessors"][0]["count"] = 100_000
    many.document["nodes"] *= 100
    with pytest.raises(InputError, match="arrays that fit in a file of its size"):
        read(many, tmp_path)


def zeros_and(count: int = 9999) -> tuple[GltfFile, dict[str, Any]]:
    """A mesh of zeros that have no bytes in the file, and its primitive, which may be changed."""
    file = GltfFile()
    file.add("accessors", count=count, componentType=5126, type="VEC3")
    on_a_node(file, mode=4)
    return file, file.document["meshes"][0]["primitives"][0]


def many_faces(count: int) -> GltfFile:
    file, primitive = zeros_and()
    file.document["meshes"][0]["primitives"] = [primitive] * count
    return file


def many_targets(count: int) -> GltfFile:
    file, primitive = zeros_and()
    primitive["targets"] = [{}] * count
    return file


def many_weights(count: int) -> GltfFile:
    """One vertex with many sets of joints, beside many vertices with one."""
    file, primitive = zeros_and()
    for rows in (9999, 1):
        file.add("accessors", count=rows, componentType=5121, type="VEC4")
        file.add("accessors", count=rows, componentType=5126, type="VEC4")
    primitive["attributes"] |= {"JOINTS_0": 1, "WEIGHTS_0": 2}
    sets = {f"{name}_{index}": 3 + place for index in range(count) for place, name in enumerate(("JOINTS", "WEIGHTS"))}
    one = {
        "attributes": {"POSITION": file.add("accessors", count=1, componentType=5126, type="VEC3"), **sets},
        "mode": 5,
    }
    file.document["meshes"][0]["primitives"].append(one)
    file.document["skins"] = [{"joints": [0]}]
    file.document["nodes"][0]["skin"] = 0
    return file


@pytest.mark.parametrize(("made", "most"), [(many_faces, 50), (many_targets, 200), (many_weights, 8)])
def test_memory_of_what_has_no_bytes_in_the_file(
    made: Callable[[int], GltfFile], most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("quaffure.io.gltf_document.FREE_BYTES", 10_000_000)
    assert read(made(1), tmp_path).meshes
    with pytest.raises(InputError, match="arrays that fit in a file of its size"):
        read(made(most), tmp_path)


def test_sets_of_weights_are_limited(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at most 8 sets of weights, found 9"):
        read(many_weights(9), tmp_path)


def test_a_file_that_several_buffers_name_is_read_once(tmp_path: Path) -> None:
    """It adds to the memory that arrays may take once, under whichever names."""
    (tmp_path / "a.bin").write_bytes(bytes(1000))
    (tmp_path / "b.bin").write_bytes(bytes(10))
    (tmp_path / "other.bin").hardlink_to(tmp_path / "a.bin")
    buffers = [{"byteLength": 9, "uri": uri} for uri in ("a.bin", "./a.bin", "a%2Ebin", "other.bin", "b.bin")]
    (tmp_path / "file.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "buffers": buffers}))
    document = open_gltf(tmp_path / "file.gltf")
    before = document.free_bytes
    contents = [document.buffer(index) for index in range(len(buffers))]
    assert document.free_bytes - before == MOST_COMPRESSION * 1010
    assert all(np.shares_memory(contents[0], content) for content in contents[:4])
