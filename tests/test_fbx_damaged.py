"""What is refused of FBX files, in one line."""

import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.io.fbx_records import MAGIC
from quaffure.io.read_character import read_character
from tests.fbx_file import FbxFile, Record, fbx_bytes, listed
from tests.test_fbx import CUBE, QUADS, bound_pair, kind, read

ABOVE, BELOW, GEOMETRY, CLUSTER = 1001, 1002, 1005, 1007
"""Numbers of objects of a `bound_pair`."""

SMALL = np.eye(4).ravel()
SMALL[:2] = 0.0, 3e-319
"""A matrix whose first pivot is so small that one over it is not finite."""


def whole() -> FbxFile:
    """A file with everything: two joints, a skin, a shape, layers and an animation."""
    file = bound_pair()
    layers = file.object(GEOMETRY).children
    layers.append(Record("LayerElementUV", [0], [kind("ByPolygonVertex"), Record("UV", [np.zeros(2)]),
                                                 Record("UVIndex", [np.zeros(24, np.int32)])]))  # fmt: skip
    layers.append(
        Record("LayerElementMaterial", [0], [kind("ByPolygon"), Record("Materials", [np.zeros(6, np.int32)])])
    )
    blend = file.add("Deformer", "BlendShape", "shapes")
    shape = file.add("Geometry", "Shape", "smile", Record("Indexes", [np.int32([5])]),
                     Record("Vertices", [np.float64([0, 1, 0])]))  # fmt: skip
    channel = file.add("Deformer", "BlendShapeChannel", "smile", listed(DeformPercent=0.0),
                       Record("FullWeights", [np.array([100.0])]))  # fmt: skip
    for child, parent in ((blend, GEOMETRY), (shape, channel), (channel, blend)):
        file.connect(child, parent)
    curves = file.curve_node(file.stack("moves"), ABOVE, "Lcl Rotation")
    file.curve(curves, "d|X", [0.0, 1.0], [0.0, 9.0])
    return file


@cache
def numbers() -> dict[str, list[int]]:
    """Numbers of the objects by the names of their records."""
    found: dict[str, list[int]] = {}
    for record in whole().objects.children:
        found.setdefault(record.name, []).append(int(record.properties[0]))
    return found


Change = Callable[[FbxFile], object]


def value(record: str, path: str, *properties: object, of: int = 0) -> Change:
    """Replace the properties of a record of an object."""

    def change(file: FbxFile) -> None:
        file.object(numbers()[record][of]).child(path).properties = list(properties)

    return change


def setting(name: str, number: float | int) -> Change:
    def change(file: FbxFile) -> None:
        for entry in file.settings.children[0].children:
            if entry.properties[0] == name:
                entry.properties[4] = number

    return change


def added(record: str, of: int = 0, **properties: object) -> Change:
    def change(file: FbxFile) -> None:
        file.object(numbers()[record][of]).children.insert(0, listed(**properties))

    return change


def without(record: str, name: str, of: int = 0) -> Change:
    def change(file: FbxFile) -> None:
        children = file.object(numbers()[record][of]).children
        children[:] = [child for child in children if child.name != name]

    return change


def connected(child: int, parent: int) -> Change:
    return lambda file: file.connect(child, parent)


def again(file: FbxFile) -> None:
    file.objects.children[1].properties[0] = np.int64(ABOVE)


def zero_scale(file: FbxFile) -> None:
    added("Model", Lcl__Scaling=(0.0, 0.0, 0.0))(file)
    added("Model", of=1, InheritType=2)(file)


NAN, FAR = np.array([np.nan] * 24), np.array([1e30] * 24)
REFUSED: dict[str, tuple[Change, str]] = {
    "left-handed": (setting("FrontAxisSign", -1), "right-handed axes, found a left-handed set"),
    "an axis twice": (setting("UpAxis", 0), "right-handed axes, found a left-handed set, or one axis twice"),
    "an axis that there is not": (setting("UpAxis", 3), "UpAxis 0, 1 or 2, its sign 1 or -1, found 3, 1"),
    "an axis of another type": (setting("UpAxis", 1.0), "a whole number as property 4"),
    "unit": (setting("UnitScaleFactor", 0.0), "a unit of 0.0001 to 1e[+]06 cm, found 0"),
    "unit that is none": (setting("UnitScaleFactor", np.nan), "a number within 1e"),
    "number twice": (again, "an object with a number of its own, found 1001 again"),
    "model below itself": (connected(ABOVE, BELOW), r"a model with one parent \(Model 'above'\)|below themselves"),
    "two parents": (connected(BELOW, 1003), r"a model with one parent \(Model 'below'\), found two"),
    "order": (added("Model", RotationActive=True, RotationOrder=6), "a rotation about three axes"),
    "inheritance": (added("Model", InheritType=7), "InheritType 0, 1 or 2 .*, found 7"),
    "scale of zero": (zero_scale, "a scale above a model of InheritType 2 .*, found 0"),
    "far model": (added("Model", Lcl__Translation=(np.inf, 0.0, 0.0)), "a number within 1e"),
    "text as number": (added("Model", Lcl__Translation="a"), "a number within 1e"),
    "vertices": (value("Geometry", "Vertices", np.zeros(23)), "rows of 3 numbers, found 23 numbers"),
    "no numbers": (value("Geometry", "Vertices", NAN), "Vertices at byte .*: expected numbers within 1e"),
    "far vertices": (value("Geometry", "Vertices", FAR), "numbers within 1e"),
    "vertices of text": (value("Geometry", "Vertices", "abc"), "an array, found none"),
    "polygons of others": (value("Geometry", "PolygonVertexIndex", np.int32([0, 1, ~8])), "vertices below 8"),
    "huge index": (value("Geometry", "PolygonVertexIndex", np.int32([0, 1, -(2**31)])), "vertices below 8"),
    "polygon without an end": (value("Geometry", "PolygonVertexIndex", np.int32([0, 1, ~2, 3])), "polygons that end"),
    "real polygons": (value("Geometry", "PolygonVertexIndex", np.zeros(3)), "whole numbers, found real ones"),
    "UVs": (value("Geometry", "LayerElementUV/UVIndex", np.ones(24, np.int32)), "a texture coordinate for every"),
    "indices of UVs": (value("Geometry", "LayerElementUV/UVIndex", np.zeros(3, np.int32)), "24 indices, found 3"),
    "vertices of a joint": (value("Deformer", "Indexes", np.int32([0, 1, 2, 8]), of=1), "weights of vertices below 8"),
    "weights of a joint": (value("Deformer", "Weights", np.ones(3), of=1), "4 weights, as many as vertices, found 3"),
    "weights below 0": (value("Deformer", "Weights", -np.ones(4), of=1), "weights from 0 up, found -1"),
    "weights that are none": (value("Deformer", "Weights", NAN[:4], of=1), "numbers within"),
    "no weights": (without("Deformer", "Weights", of=1), "a record Weights, found none"),
    "no matrix": (without("Deformer", "TransformLink", of=1), "a record TransformLink, found none"),
    "short matrix": (value("Deformer", "Transform", np.zeros(12), of=1), "rows of 16 numbers, found 12"),
    "two matrices": (value("Deformer", "Transform", np.zeros(32), of=1), "16 numbers, found 32"),
    "flat matrix": (value("Deformer", "Transform", np.zeros(16), of=1), "a matrix with an inverse"),
    "small matrix": (value("Deformer", "Transform", SMALL, of=1), "a matrix with an inverse"),
    "shape": (value("Geometry", "Indexes", np.int32([8]), of=1), "vertices below 8"),
    "differences": (value("Geometry", "Vertices", np.zeros(6), of=1), "1 differences, as many as vertices, found 2"),
    "keys that go back": (value("AnimationCurve", "KeyTime", np.int64([5, 1])), "times that do not decrease"),
    "keys beyond time": (value("AnimationCurve", "KeyTime", np.int64([0, 2**62])), "within 1e[+]06 s"),
    "values of keys": (value("AnimationCurve", "KeyValueFloat", np.float32([1])), "2 values, as many as keys, found 1"),
    "keys of nothing": (value("AnimationCurve", "KeyValueFloat", np.float32([1, np.nan])), "numbers within"),
    "flags": (value("AnimationCurve", "KeyAttrRefCount", np.int32([1, 2**31 - 1])), "flags of 2 keys"),
    "numbers of keys": (value("AnimationCurve", "KeyAttrDataFloat", np.zeros(3)), "8 numbers, found 3"),
    "slopes": (value("AnimationCurve", "KeyAttrDataFloat", NAN[:8]), "numbers within"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_contradictions_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    change, message = REFUSED[name]
    file = whole()
    assert read(file, tmp_path).animations
    change(file)
    with pytest.raises(InputError, match=message) as refusal:
        read(file, tmp_path)
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 400


def test_models_that_are_below_themselves(tmp_path: Path) -> None:
    file = FbxFile()
    first, second = file.model("a"), file.model("b")
    file.connections.children.clear()
    file.connect(first, second)
    file.connect(second, first)
    with pytest.raises(InputError, match="models in trees, found models below themselves"):
        read(file, tmp_path)


def test_a_share_that_adds_to_others_is_refused(tmp_path: Path) -> None:
    file = whole()
    file.object(CLUSTER).children.append(Record("Mode", ["Additive"]))
    with pytest.raises(InputError, match=r"weights share a vertex \(Normalize, Total1\), found Additive"):
        read(file, tmp_path)


def test_files_of_other_kinds_say_what_to_export(tmp_path: Path) -> None:
    text = b"; FBX 7.4.0 project file\n; ----\n\nFBXHeaderExtension:  {\n"
    for content, found in (
        (text, "an FBX of text"),
        (MAGIC + struct.pack("<I", 6100) + bytes(100), "version 6.1"),
        (MAGIC + struct.pack("<I", 7800) + bytes(100), "version 7.8"),
        (b"", "another file"),
        (b"PK\x03\x04", "another file"),
    ):
        expected = rf"a binary FBX file of version 7\.1 to 7\.7 \(Blender: File > Export > FBX.*\), found {found}"
        with pytest.raises(InputError, match=expected):
            read(content, tmp_path)
    with pytest.raises(InputError, match="found no such file"):
        read_character(tmp_path / "none.fbx")
    with pytest.raises(InputError, match="to hold its version"):
        read(MAGIC, tmp_path)
    for sections in ([], [Record("Objects")]):
        with pytest.raises(InputError, match="sections Objects and Connections"):
            read(fbx_bytes(sections), tmp_path)
    with pytest.raises(InputError, match="1 to 65536 models, found 0"):
        read(fbx_bytes([Record("Objects"), Record("Connections")]), tmp_path)


def header(end: int, count: int, size: int, name: bytes = b"Objects") -> bytes:
    return MAGIC + struct.pack("<I", 7400) + struct.pack("<III", end, count, size) + bytes([len(name)]) + name


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (header(2**32 - 1, 0, 0), "an end from byte 47 to 47, found 4294967295"),
        (header(30, 0, 0), "an end from byte 47 to 47, found 30"),
        (header(47, 0, 2**31), "an end from byte"),
        (header(47, 0, 0)[:-9], "13 bytes, found 11"),
    ],
)
def test_records_that_end_elsewhere(content: bytes, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read(content, tmp_path)


@pytest.mark.parametrize(
    ("properties", "count", "message"),
    [
        (b"", 2**32 - 1, "at most 0 properties in its bytes, found 4294967295"),
        (b"L\0\0", 1, "properties of at least 9 bytes, found 3"),
        (b"S" + struct.pack("<I", 2**32 - 1), 1, "properties of at least 4294967300 bytes, found 5"),
        (b"Q1", 1, "properties of known types, found 'Q'"),
        (b"d" + struct.pack("<III", 2**32 - 1, 0, 8) + bytes(8), 1, "properties of at least 34359738373 bytes"),
        (b"d" + struct.pack("<III", 1, 2, 8) + bytes(8), 1, "raw or a zlib stream, found encoding 2"),
        (b"d" + struct.pack("<III", 1, 0, 8) + bytes(3), 1, "properties of at least 21 bytes, found 16"),
    ],
    ids=["count", "short number", "long text", "type", "long array", "encoding", "short array"],
)
def test_properties_of_other_sizes(properties: bytes, count: int, message: str, tmp_path: Path) -> None:
    name = b"Model"
    inner = 27 + 13 + 7  # where the object begins
    end = inner + 13 + len(name) + len(properties)
    model = struct.pack("<III", end, count, len(properties)) + bytes([len(name)]) + name + properties
    links = b"Connections"
    after = struct.pack("<III", end + 13 + len(links), 0, 0) + bytes([len(links)]) + links
    with pytest.raises(InputError, match=message):
        read(header(end, 0, 0) + model + after + bytes(13), tmp_path)


def deflated(content: bytes, count: int) -> bytes:
    """A file whose vertices are a zlib stream of so many numbers, as its header says."""
    file = FbxFile()
    file.geometry(file.model("a"), CUBE, QUADS)
    whole = file.content(is_deflated=True)
    at = whole.index(b"Vertices") + len(b"Vertices")
    (length,) = struct.unpack_from("<I", whole, at + 9)
    new = b"d" + struct.pack("<III", count, 1, len(content)) + content
    # The sizes of the records around it change by the same number, so it is padded instead.
    assert len(new) <= 13 + length
    return whole[:at] + new + whole[at + len(new) :]


@pytest.mark.parametrize(
    ("content", "count", "message"),
    [
        (zlib.compress(bytes(8 * 10)), 24, "192 bytes in its zlib stream, found 80"),
        (zlib.compress(bytes(8 * 30)), 24, "192 bytes in its zlib stream, found more"),
        (b"not a zlib stream", 24, "a zlib stream, found Error -3"),
        (zlib.compress(bytes(8 * 24))[:-5], 24, "192 bytes in its zlib stream, found 192"),
        (zlib.compress(bytes(8 * 24)), 2**31 - 1, "at most .* bytes of .* compressed ones, found 17179869176"),
    ],
    ids=["short", "long", "other bytes", "without an end", "bomb"],
)
def test_streams_of_another_size(content: bytes, count: int, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read(deflated(content, count), tmp_path)


def test_records_that_nothing_reads_are_not_opened(tmp_path: Path) -> None:
    """A camera whose properties end beyond the file, and a model that is damaged in the same way."""
    for name in ("NodeAttribute", "Model"):
        file = whole()
        file.objects.children.append(Record(name, [np.int64(99), "a", ""], [Record("Damaged")]))
        content = file.content()
        end = content.index(b"Damaged") - 13  # of 32 bits, before two other numbers and the length of the name
        content = content[:end] + struct.pack("<I", 2**32 - 1) + content[end + 4 :]
        if name == "NodeAttribute":
            assert read(content, tmp_path).meshes
            continue
        with pytest.raises(InputError, match="an end from byte"):
            read(content, tmp_path)
