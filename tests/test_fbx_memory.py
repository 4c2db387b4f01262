"""What small FBX files may take of the memory and of the time: it is counted before it is taken."""

import sys
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.io.read_character import read_character
from tests.fbx_file import FbxFile, Record
from tests.test_fbx import CUBE, QUADS


def zeros() -> FbxFile:
    """A stream of zeros."""
    file = FbxFile()
    file.geometry(file.model("a"), np.zeros((300_000, 3)), QUADS)
    return file


def shown_often(file: FbxFile, geometry: int) -> FbxFile:
    """A geometry on many models."""
    for index in range(400):
        file.connect(geometry, file.model(f"{index}"))
    return file


def many_vertices() -> FbxFile:
    file = FbxFile()
    return shown_often(file, file.geometry(file.model("a"), np.zeros((200, 3)), QUADS))


def many_faces() -> FbxFile:
    file = FbxFile()
    return shown_often(file, file.geometry(file.model("a"), CUBE, 2000 * [[0, 1, 2]]))


def many_clusters() -> FbxFile:
    file = FbxFile()
    model = file.model("a")
    geometry = file.geometry(model, CUBE, QUADS)
    skin = file.skin(geometry)
    for _ in range(100):
        file.cluster(skin, model, np.zeros(0), np.zeros(0), np.eye(4), np.eye(4))
    return shown_often(file, geometry)


def one_strong_vertex() -> FbxFile:
    """Clusters that all move one vertex of many, each of which has as many places for joints."""
    file = FbxFile()
    model = file.model("a")
    skin = file.skin(file.geometry(model, np.zeros((4000, 3)), QUADS))
    for _ in range(40):
        file.cluster(skin, model, np.zeros(1), np.ones(1), np.eye(4), np.eye(4))
    return file


def slider(file: FbxFile, geometry: int, full: np.ndarray) -> int:
    blend = file.add("Deformer", "BlendShape", "shapes")
    file.connect(blend, geometry)
    channel = file.add("Deformer", "BlendShapeChannel", "a", Record("FullWeights", [full]))
    file.connect(channel, blend)
    return channel


def many_shapes() -> FbxFile:
    """Shapes of many vertices."""
    file = FbxFile()
    channel = slider(file, file.geometry(file.model("a"), np.zeros((2000, 3)), QUADS), np.arange(1.0, 100))
    for index in range(99):
        file.connect(file.add("Geometry", "Shape", f"{index}"), channel)
    return file


def one_shape_often(count: int) -> FbxFile:
    file = FbxFile()
    channel = slider(file, file.geometry(file.model("a"), CUBE, QUADS), np.arange(1.0, count + 1))
    shape = file.add("Geometry", "Shape", "a")
    for _ in range(count):
        file.connect(shape, channel)
    return file


def many_sliders() -> FbxFile:
    file = one_shape_often(100)
    return shown_often(file, 1002)


def distant_keys() -> FbxFile:
    file = FbxFile()
    curves = file.curve_node(file.stack("a"), file.model("a"), "Lcl Rotation")
    file.curve(curves, "d|X", [0, 1e6], [0, 1])
    return file


def many_stacks() -> FbxFile:
    """Animations of one model of many."""
    file = FbxFile()
    for index in range(200):
        file.model(f"{index}")
    for index in range(200):
        curves = file.curve_node(file.stack(f"{index}"), 1001, "Lcl Rotation")
        file.curve(curves, "d|X", [0, 1], [0, 1])
    return file


def one_layer_of_many_stacks() -> FbxFile:
    """A layer that moves many models, in many animations."""
    file = FbxFile()
    layer = file.stack("a")
    for index in range(50):
        curves = file.curve_node(layer, file.model(f"{index}"), "Lcl Rotation")
        file.curve(curves, "d|X", [0, 0.05], [0, 1])
    for index in range(50):
        file.connect(layer, file.add("AnimationStack", "", f"{index}"))
    return file


def one_layer_often() -> FbxFile:
    """A layer that is often in an animation, with much that moves nothing."""
    file = FbxFile()
    file.model("a")
    layer = file.stack("a")
    for _ in range(700):
        file.connect(layer, layer - 1)
    for _ in range(300):
        file.connect(file.add("AnimationCurveNode", "", ""), layer)
    return file


HOSTILE = (zeros, many_vertices, many_faces, many_clusters, one_strong_vertex, many_shapes, many_sliders, distant_keys,
           many_stacks, one_layer_of_many_stacks, one_layer_often)  # fmt: skip


@pytest.fixture
def small_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("quaffure.io.fbx_records.FREE_BYTES", 4_000_000)
    monkeypatch.setattr("quaffure.io.fbx_records.MOST_COMPRESSION", 1)


def peak(path: Path) -> int:
    """Bytes that reading a file takes at most; what it is refused for is not raised."""
    tracemalloc.start()
    try:
        with suppress(InputError):
            read_character(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def calls(path: Path) -> int:
    """Functions of Python that reading a file calls, which are in proportion to its time."""
    counts = {"call": 0}

    def count(_frame: object, event: str, _argument: object) -> None:
        counts[event] = counts.get(event, 0) + 1

    sys.setprofile(count)
    try:
        with suppress(InputError):
            read_character(path)
    finally:
        sys.setprofile(None)
    return counts["call"]


@pytest.mark.usefixtures("small_budget")
@pytest.mark.parametrize("file", HOSTILE)
def test_memory_and_work_are_counted_before_they_are_taken(file: Callable[[], FbxFile], tmp_path: Path) -> None:
    path = tmp_path / "small.fbx"
    path.write_bytes(file().content(is_deflated=True))
    with pytest.raises(InputError, match="arrays that fit in a file of its size"):
        read_character(path)
    assert peak(path) < 8_000_000
    assert calls(path) < 1_000_000


@pytest.mark.usefixtures("small_budget")
def test_memory_of_a_slider_is_in_proportion_to_its_shapes(tmp_path: Path) -> None:
    path = tmp_path / "small.fbx"
    path.write_bytes(one_shape_often(1500).content())
    assert len(read_character(path).meshes[0].morph_targets) == 1500
    assert peak(path) < 8_000_000
