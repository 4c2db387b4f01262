"""Small glTF files, written for tests: arrays in every layout, and a figure on a Mixamo rig that moves."""

import base64
import json
import struct
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """A document with one buffer; `document` may be changed before it is written."""

    def __init__(self) -> None:
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "nodes": [], "meshes": [],
        }  # fmt: skip
        self.binary = bytearray()

    def view(self, content: bytes, **fields: Any) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content), **fields}
        self.document["bufferViews"].append(view)
        self.binary += content
        return len(self.document["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, **fields: Any) -> int:
        """Rows of numbers, one after another."""
        values = np.ascontiguousarray(values)
        rows = values.reshape(len(values), -1)
        return self.add("accessors", bufferView=self.view(values.tobytes()), count=len(rows),
                        componentType=COMPONENTS[values.dtype.name], type=KINDS[rows.shape[1]], **fields)  # fmt: skip

    def add(self, kind: str, **fields: Any) -> int:
        self.document.setdefault(kind, []).append(fields)
        return len(self.document[kind]) - 1

    def animation(self, name: str, channels: list[tuple[int, str, str, np.ndarray, np.ndarray]]) -> None:
        """An animation of channels: node, path, interpolation, times, values."""
        samplers = [
            {
                "input": self.accessor(np.float32(times)),
                "output": self.accessor(np.float32(values)),
                "interpolation": how,
            }
            for _, _, how, times, values in channels
        ]
        targets = [{"sampler": i, "target": {"node": c[0], "path": c[1]}} for i, c in enumerate(channels)]
        self.add("animations", name=name, samplers=samplers, channels=targets)

    def _finished(self, uri: str | None = None) -> dict[str, Any]:
        buffer = {"byteLength": len(self.binary)} | ({} if uri is None else {"uri": uri})
        return self.document | {"buffers": [buffer, *self.document.get("buffers", [])]}

    def glb(self) -> bytes:
        text = json.dumps(self._finished()).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + bytes(-len(self.binary) % 4)
        parts = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
        return struct.pack("<III", 0x46546C67, 2, 12 + len(parts)) + parts

    def gltf(self, uri: str | None = None) -> bytes:
        """JSON, its buffer embedded or in a file beside it."""
        embedded = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        return json.dumps(self._finished(uri or embedded)).encode()


# Name, parent, place in a T pose [cm], y up, facing +z: a figure of 170 cm.
MIXAMO = {
    "Hips": ("", (0, 95, 0)), "Spine": ("Hips", (0, 106, 0)), "Spine1": ("Spine", (0, 118, 0)),
    "Spine2": ("Spine1", (0, 130, 0)), "Neck": ("Spine2", (0, 145, 0)), "Head": ("Neck", (0, 153, 1)),
    **{f"{side}{joint}": (parent if parent.startswith("Spine") or parent == "Hips" else side + parent, (x * sign, y, z))
       for side, sign in (("Left", 1), ("Right", -1))
       for joint, parent, (x, y, z) in (
           ("Shoulder", "Spine2", (5, 141, 0)), ("Arm", "Shoulder", (17, 140, 0)), ("ForeArm", "Arm", (43, 140, 0)),
           ("Hand", "ForeArm", (68, 140, 0)), ("HandMiddle1", "Hand", (76, 140, 0)), ("UpLeg", "Hips", (9, 90, 0)),
           ("Leg", "UpLeg", (9, 50, 1)), ("Foot", "Leg", (9, 9, -1)), ("ToeBase", "Foot", (9, 3, 11)))},
}  # fmt: skip
NAMES = tuple(MIXAMO)
PARENTS = np.array([NAMES.index(parent) if parent else -1 for parent, _ in MIXAMO.values()])
PLACES = np.array([place for _, place in MIXAMO.values()], dtype=float)
SCALE = 0.01
"""Of the node above the hips, as files from centimetres have it."""


def figure(
    turned: np.ndarray | None = None, path: np.ndarray | None = None, fps: float = 30.0, prefix: str = "mixamorig:",
    places: np.ndarray = PLACES,
) -> GltfFile:  # fmt: skip
    """A skinned figure whose joints have frames of any rotation, below a node that makes metres of centimetres.

    Args:
        turned: rotation of each joint from rest, relative to its parent, in the scene's axes [frames, joints, 3, 3].
        path: place of the hips [frames, 3] [cm].
        places: of the joints at rest [cm].
    """
    file = GltfFile()
    frames = Rotation.from_rotvec(np.random.default_rng(3).normal(size=(len(NAMES), 3)))
    above = [frames[p] if p >= 0 else Rotation.identity() for p in PARENTS]
    offsets = places - np.where(PARENTS[:, None] < 0, 0, places[PARENTS])
    file.add("nodes", name="Armature", children=[1], scale=[SCALE] * 3)
    for joint, name in enumerate(NAMES):
        children = [int(child) + 1 for child in np.flatnonzero(joint == PARENTS)]
        fields = {"children": children} if children else {}
        file.add("nodes", name=prefix + name, translation=above[joint].inv().apply(offsets[joint]).tolist(),
                 rotation=(above[joint].inv() * frames[joint]).as_quat().tolist(), **fields)  # fmt: skip
    _add_skin(file, frames, places)
    file.document |= {"scene": 0, "scenes": [{"nodes": [0, len(NAMES) + 1]}]}
    if turned is not None:
        times = np.arange(len(turned)) / fps
        channels = [
            (joint + 1, "rotation", "LINEAR", times,
             (above[joint].inv() * Rotation.from_matrix(turned[:, joint]) * frames[joint]).as_quat())
            for joint in range(len(NAMES))
        ]  # fmt: skip
        file.animation("moves", channels)
        if path is not None:
            file.document["animations"][0]["samplers"].append(
                {"input": file.accessor(np.float32(times)), "output": file.accessor(np.float32(path))}
            )
            file.document["animations"][0]["channels"].append(
                {"sampler": len(channels), "target": {"node": 1, "path": "translation"}}
            )
    return file


def _add_skin(file: GltfFile, frames: Rotation, places: np.ndarray) -> None:
    """A mesh of a tetrahedron round every joint, bound in metres."""
    corners = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 3]])
    vertices = SCALE * (places[:, None] + corners).reshape(-1, 3)
    faces = (4 * np.arange(len(NAMES))[:, None, None] + [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).reshape(-1)
    world = np.tile(np.eye(4), (len(NAMES), 1, 1))
    world[:, :3, :3], world[:, :3, 3] = SCALE * frames.as_matrix(), SCALE * places
    matrices = np.linalg.inv(world).transpose(0, 2, 1).reshape(-1, 16)
    joints = np.zeros((len(vertices), 4), np.uint8)
    joints[:, 0] = np.repeat(np.arange(len(NAMES)), 4)
    attributes = {
        "POSITION": file.accessor(np.float32(vertices)), "JOINTS_0": file.accessor(joints),
        "WEIGHTS_0": file.accessor(np.float32([[1, 0, 0, 0]] * len(vertices))),
    }  # fmt: skip
    file.add("materials", name="Skin")
    primitive = {"attributes": attributes, "indices": file.accessor(np.uint16(faces)), "material": 0}
    file.add("meshes", name="Body", primitives=[primitive])
    file.add("skins", joints=list(range(1, len(NAMES) + 1)), inverseBindMatrices=file.accessor(np.float32(matrices)))
    file.add("nodes", name="Body", mesh=0, skin=0)
