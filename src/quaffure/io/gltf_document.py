"""Opens a glTF 2.0 file (.glb, .gltf): its JSON, and the buffers in it, beside it or written into the JSON."""

import base64
import binascii
import json
from codecs import BOM_UTF8
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from urllib.parse import unquote

import numpy as np
from jaxtyping import UInt8

from quaffure.errors import InputError, refused
from quaffure.input_file import check_input_file
from quaffure.io.binary import BinaryCursor
from quaffure.io.character_limits import FREE_BYTES, MOST_COMPRESSION
from quaffure.io.distinct_names import one_line
from quaffure.io.gltf_entry import Entry

GLTF_SUFFIXES = (".glb", ".gltf")
EXPECTED = "a glTF 2.0 file (.glb, .gltf)"
GLB_JSON, GLB_BINARY = 0x4E4F534A, 0x004E4942
KNOWN_EXTENSIONS = ("KHR_mesh_quantization", "EXT_meshopt_compression")
# What these change is seen in pictures alone.
IGNORED_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "KHR_xmp")
ADVICE = {"KHR_draco_mesh_compression": "KHR_draco_mesh_compression (export it without Draco compression)"}

Bytes = UInt8[np.ndarray, " n"]


@dataclass
class GltfDocument:
    """A glTF file that is open for reading.

    Attributes:
        root: its JSON.
        binary: the binary part of a .glb.
        free_bytes: that its arrays may still take.
    """

    root: Entry
    binary: Bytes | None
    free_bytes: int
    _buffers: dict[int, Bytes] = field(default_factory=dict)
    _files: dict[tuple[int, int], Bytes] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        return self.root.path

    def take(self, count: int, what: Entry) -> None:
        """Account for bytes before memory is taken for them.

        Raises:
            InputError: more than a file of this size should hold.
        """
        self.free_bytes -= count
        if self.free_bytes < 0:
            what.fail("arrays that fit in a file of its size", f"{count} more bytes")

    def buffer(self, index: int) -> Bytes:
        """The bytes of a buffer, at least as many as it says that it has.

        Raises:
            InputError: they cannot be read, or are fewer.
        """
        if index not in self._buffers:
            entry = self.root.entries("buffers")[index]
            length = entry.integer("byteLength", most=2**32)
            content = self._content(index, entry)
            if len(content) < length:
                entry.fail(f"{length} bytes", f"{len(content)}")
            self._buffers[index] = content[:length]
        return self._buffers[index]

    def _content(self, index: int, entry: Entry) -> Bytes:
        if "uri" not in entry:
            if index == 0 and self.binary is not None:
                return self.binary
            entry.fail("a uri, or to be the binary part of a .glb", "neither")
        uri = entry.fields["uri"]
        if not isinstance(uri, str):
            entry.fail("a uri", repr(uri)[:40])
        if uri.startswith("data:"):
            kind, _, text = uri.partition(",")
            if not kind.endswith(";base64"):
                entry.fail("data in base64", f"{kind[:40]!r}")
            with refused(f"{self.path}, {entry.place}", "data in base64", binascii.Error, ValueError):
                return np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
        name = unquote(uri)
        relative = Path(name)
        if ":" in name or relative.is_absolute() or ".." in relative.parts or not name:
            entry.fail("a file in the folder of the .gltf", f"{one_line(name)!r}")
        beside = self.path.parent / relative
        check_input_file(beside, "a buffer of a .gltf")
        status = beside.stat()
        file = status.st_dev, status.st_ino  # whatever its name, once: else each entry would add to what is free
        if file not in self._files:
            self._files[file] = np.frombuffer(BinaryCursor(beside).content, np.uint8)
            self.free_bytes += MOST_COMPRESSION * len(self._files[file])
        return self._files[file]


def open_gltf(path: Path) -> GltfDocument:
    """A glTF 2.0 file of either form, by its content.

    Raises:
        InputError: no such file, another format or version, damaged, or with a required extension that is not read.
    """
    check_input_file(path, EXPECTED)
    cursor = BinaryCursor(path)
    if cursor.content[:4] == b"glTF":
        text, binary = _glb_parts(cursor)
    elif cursor.content.removeprefix(BOM_UTF8).lstrip()[:1] in (b"{", b"["):
        text, binary = cursor.content, None
    else:
        raise InputError(path, EXPECTED, "neither its header nor JSON")
    with refused(path, EXPECTED, ValueError, RecursionError, UnicodeDecodeError):
        fields = json.loads(text.decode("utf-8-sig"), parse_constant=_refuse_constant)
    if not isinstance(fields, dict):
        raise InputError(path, EXPECTED, "JSON that is no object")
    document = GltfDocument(Entry(path, "", fields), binary, max(FREE_BYTES, MOST_COMPRESSION * len(cursor.content)))
    _check_version(document.root)
    _check_extensions(document.root)
    return document


def _glb_parts(cursor: BinaryCursor) -> tuple[bytes, Bytes | None]:
    """JSON and binary part of a .glb."""
    _, version, _ = cursor.integers("<u4", 3, "header")
    if version != 2:
        raise InputError(cursor.path, EXPECTED, f"version {version}")
    text, binary = None, None
    while cursor.offset < len(cursor.content) and (text is None or binary is None):
        size, kind = cursor.integers("<u4", 2, "chunk header")
        content = cursor.array("u1", size, "chunk")
        if text is None:
            if kind != GLB_JSON:
                raise InputError(cursor.path, "JSON first in a .glb", f"a chunk {kind:#x}")
            text = content.tobytes()
        elif kind == GLB_BINARY:
            binary = content
    if text is None:
        raise InputError(cursor.path, EXPECTED, "no chunk")
    return text, binary


def _check_version(root: Entry) -> None:
    asset = root.required("asset")
    version = asset.text("minVersion", asset.text("version"))
    if version != "2.0" and not (version.startswith("2.") and "minVersion" not in asset):
        asset.fail("version 2.0", f"{version[:20]!r}")


def _check_extensions(root: Entry) -> None:
    required = root.fields.get("extensionsRequired", [])
    if not isinstance(required, list) or not all(isinstance(name, str) for name in required):
        root.fail("names in extensionsRequired", repr(required)[:40])
    unknown = [
        ADVICE.get(name, one_line(name)[:60])
        for name in required
        if name not in KNOWN_EXTENSIONS and not name.startswith(IGNORED_EXTENSIONS)
    ]
    if unknown:
        root.fail(f"no required extensions but {', '.join(KNOWN_EXTENSIONS)}", ", ".join(unknown[:5]))


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name}, which JSON does not have")
