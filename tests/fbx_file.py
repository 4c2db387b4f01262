"""Small binary FBX files, written for tests: records of 32 or 64 bits, arrays as they are or as zlib streams."""

import struct
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

ARRAY_TYPES = {"float32": b"f", "float64": b"d", "int32": b"i", "int64": b"l", "bool": b"b"}
FOOTER = bytes(120)
TICKS = 46_186_158_000
LINEAR, CONSTANT, CUBIC = 0x4, 0x2, 0x8
Y_UP = {"UpAxis": 1, "UpAxisSign": 1, "FrontAxis": 2, "FrontAxisSign": 1, "CoordAxis": 0, "CoordAxisSign": 1}
Z_UP = {"UpAxis": 2, "UpAxisSign": 1, "FrontAxis": 1, "FrontAxisSign": -1, "CoordAxis": 0, "CoordAxisSign": 1}


@dataclass
class Record:
    """A record: its name, its properties, and the records below it.

    Properties are `int` (32 bits), `np.int64`, `np.int16`, `bool`, `float` (64 bits), `np.float32`, `str`, `bytes` and
    arrays.
    """

    name: str
    properties: list[Any] = field(default_factory=list)
    children: list["Record"] = field(default_factory=list)

    def child(self, path: str) -> "Record":
        """A record below: names and numbers of the record among those of its name, with slashes between."""
        record = self
        for step in path.split("/"):
            name, _, number = step.partition("#")
            record = [child for child in record.children if child.name == name][int(number or 0)]
        return record


def listed(**properties: Any) -> Record:
    """A list of properties; a tuple is a vector, and `__` in a name is a blank."""
    entries = []
    for name, value in properties.items():
        values = [float(each) for each in value] if isinstance(value, tuple) else [value]
        entries.append(Record("P", [name.replace("__", " "), "", "", "", *values]))
    return Record("Properties70", [], entries)


class FbxFile:
    """Objects and connections; `sections` may be changed before they are written."""

    def __init__(self, axes: dict[str, int] = Y_UP, unit: float = 1.0) -> None:
        self.settings = Record("GlobalSettings", [], [listed(**axes, UnitScaleFactor=unit)])
        self.header, self.definitions = Record("FBXHeaderExtension"), Record("Definitions")
        self.objects, self.connections = Record("Objects"), Record("Connections")

    @property
    def sections(self) -> list[Record]:
        return [self.header, self.settings, self.definitions, self.objects, self.connections]

    def add(self, record: str, kind: str, name: str, *children: Record, **properties: Any) -> int:
        """Add an object; its number."""
        number = len(self.objects.children) + 1001
        below = [*([listed(**properties)] if properties else []), *children]
        self.objects.children.append(Record(record, [np.int64(number), f"{name}\0\1{record}", kind], below))
        return number

    def connect(self, child: int, parent: int, name: str = "") -> None:
        ends = ["OP" if name else "OO", np.int64(child), np.int64(parent)]
        self.connections.children.append(Record("C", [*ends, *([name] if name else [])]))

    def object(self, number: int) -> Record:
        return self.objects.children[number - 1001]

    def model(self, name: str, parent: int = 0, kind: str = "LimbNode", **properties: Any) -> int:
        number = self.add("Model", kind, name, **properties)
        self.connect(number, parent)
        return number

    def geometry(self, model: int, vertices: np.ndarray, polygons: list[list[int]], *layers: Record) -> int:
        """A mesh of a model, whose vertices are in its own space."""
        corners = [corner if place < len(polygon) - 1 else ~corner
                   for polygon in polygons for place, corner in enumerate(polygon)]  # fmt: skip
        number = self.add(
            "Geometry", "Mesh", "mesh", Record("Vertices", [np.float64(vertices).reshape(-1)]),
            Record("PolygonVertexIndex", [np.array(corners, np.int32)]), *layers,
        )  # fmt: skip
        self.connect(number, model)
        return number

    def skin(self, geometry: int) -> int:
        number = self.add("Deformer", "Skin", "skin")
        self.connect(number, geometry)
        return number

    def cluster(
        self, skin: int, joint: int, vertices: np.ndarray, weights: np.ndarray, mesh: np.ndarray, bone: np.ndarray
    ) -> int:
        """Vertices that a joint moves; matrices of mesh and joint in the file's scene when it was bound."""
        number = self.add(
            "Deformer", "Cluster", "cluster", Record("Indexes", [np.int32(vertices)]),
            Record("Weights", [np.float64(weights)]),
            Record("Transform", [(np.linalg.inv(bone) @ mesh).T.reshape(-1).copy()]),
            Record("TransformLink", [bone.T.reshape(-1).copy()]),
        )  # fmt: skip
        self.connect(number, skin)
        self.connect(joint, number)
        return number

    def stack(self, name: str) -> int:
        """An animation of one layer; the number of the layer."""
        stack, layer = self.add("AnimationStack", "", name), self.add("AnimationLayer", "", "BaseLayer")
        self.connect(layer, stack)
        return layer

    def curve_node(self, layer: int, owner: int, name: str, **still: float) -> int:
        """What a layer moves of an object; values of components without a curve."""
        number = self.add("AnimationCurveNode", "", name, listed(**still))
        self.connect(number, layer)
        self.connect(number, owner, name)
        return number

    def curve(
        self, curve_node: int, component: str, times: np.ndarray, values: np.ndarray, flags: Any = LINEAR,
        slopes: np.ndarray | None = None,
    ) -> int:  # fmt: skip
        """A curve of a component (`d|X`); slopes after each key and before the next one."""
        times = np.asarray(times, dtype=float)
        numbers = np.zeros((len(times), 4), np.float32)
        if slopes is not None:
            numbers[:, :2] = slopes
        number = self.add(
            "AnimationCurve", "", "", Record("KeyTime", [np.int64(np.rint(times * TICKS))]),
            Record("KeyValueFloat", [np.float32(values)]),
            Record("KeyAttrFlags", [np.full(len(times), flags, np.int32)]),
            Record("KeyAttrDataFloat", [numbers.reshape(-1)]),
            Record("KeyAttrRefCount", [np.ones(len(times), np.int32)]),
        )  # fmt: skip
        self.connect(number, curve_node, component)
        return number

    def content(self, version: int = 7400, is_deflated: bool = False) -> bytes:
        return fbx_bytes(self.sections, version, is_deflated)


def fbx_bytes(sections: list[Record], version: int = 7400, is_deflated: bool = False) -> bytes:
    """A file of records."""
    head = b"Kaydara FBX Binary  \0\x1a\0" + struct.pack("<I", version)
    body = b""
    for section in sections:
        body += _encoded(section, len(head) + len(body), version, is_deflated)
    return head + body + bytes(25 if version >= 7500 else 13) + FOOTER


def _encoded(record: Record, at: int, version: int, is_deflated: bool) -> bytes:
    form = "<QQQ" if version >= 7500 else "<III"
    name = record.name.encode()
    properties = b"".join(_property(value, is_deflated) for value in record.properties)
    head = struct.calcsize(form) + 1 + len(name)
    below = b""
    for child in record.children:
        below += _encoded(child, at + head + len(properties) + len(below), version, is_deflated)
    if record.children:
        below += bytes(struct.calcsize(form) + 1)
    end = at + head + len(properties) + len(below)
    start = struct.pack(form, end, len(record.properties), len(properties)) + bytes([len(name)]) + name
    return start + properties + below


def _property(value: Any, is_deflated: bool) -> bytes:
    if isinstance(value, np.ndarray):
        content = value.tobytes()
        stored = zlib.compress(content) if is_deflated else content
        return ARRAY_TYPES[value.dtype.name] + struct.pack("<III", value.size, is_deflated, len(stored)) + stored
    if isinstance(value, str | bytes):
        text = value.encode() if isinstance(value, str) else value
        return (b"S" if isinstance(value, str) else b"R") + struct.pack("<I", len(text)) + text
    for kind, code, form in ((bool, b"C", "<B"), (np.int16, b"Y", "<h"), (np.int64, b"L", "<q"), (int, b"I", "<i"),
                             (np.float32, b"F", "<f"), (float, b"D", "<d")):  # fmt: skip
        if isinstance(value, kind):
            return code + struct.pack(form, value)
    raise TypeError(type(value))
