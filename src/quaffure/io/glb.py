"""glTF 2.0 in one binary file (.glb), for pages and engines: body and strands as meshes, every frame a morph target.

Metres, y up and the face towards +z, as glTF asks: (x, y, z) of the drape is (x, z, -y). Between two frames a viewer
mixes their targets, so hair moves along straight lines. Only positions
are morphed; normals are those of the first frame.
"""

import json
import shutil
import struct
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from jaxtyping import Float, Int

from quaffure.errors import InputError
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.hair.export_clip import HAIR_COLOUR, ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.strand_mesh import strand_mesh_faces, strand_mesh_normals, strand_mesh_positions

GLB_SUFFIX = ".glb"
BODY_COLOUR = (0.62, 0.50, 0.435)
MOST_BYTES = 2**32 - 1
"""The format counts with 32 bits."""
FLOAT, UNSIGNED_INT = 5126, 5125
VERTICES, INDICES = 34962, 34963
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def write_glb(path: Path, clip: ExportClip, on_frame: Callable[[], object] = lambda: None) -> None:
    """Write body and strands of a drape as meshes, ribbons or tubes as the settings of the clip say.

    Args:
        on_frame: called after each frame.

    Raises:
        InputError: another suffix than .glb, more than 4 GB, or not writable.
    """
    if path.suffix.lower() != GLB_SUFFIX:
        raise InputError(path, f"a name ending in {GLB_SUFFIX}", f"{path.suffix or 'no suffix'}")
    with replacing(path) as temporary, tempfile.TemporaryFile(dir=temporary.parent) as binary:
        asset = _Asset(binary, path)
        _add_meshes(asset, clip, on_frame)
        document = json.dumps(asset.document(clip)).encode()
        document += b" " * (-len(document) % 4)
        length = asset.size
        if 12 + 8 + len(document) + 8 + length > MOST_BYTES:
            raise InputError(path, "at most 4 GB of .glb (--points, --every)", f"{length / 1e9:.1f} GB")
        with temporary.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(document) + 8 + length))
            file.write(struct.pack("<II", len(document), JSON_CHUNK) + document)
            file.write(struct.pack("<II", length, BINARY_CHUNK))
            binary.seek(0)
            shutil.copyfileobj(binary, file)


class _Asset:
    """Arrays of a file, written as they come, and what the document says of them."""

    def __init__(self, binary: IO[bytes], path: Path) -> None:
        self._binary, self._path = binary, path
        self.size = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Write an array; the index of its accessor."""
        values = np.ascontiguousarray(values)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": values.nbytes}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        component = FLOAT if values.dtype == np.float32 else UNSIGNED_INT
        accessor = {"bufferView": len(self.views) - 1, "componentType": component, "count": len(values), "type": kind}
        if bounds:
            flat = values.reshape(len(values), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.accessors.append(accessor)
        self._binary.write(values.data)
        self.size += values.nbytes
        if self.size > MOST_BYTES:
            raise InputError(self._path, "at most 4 GB of .glb (--points, --every)", "more")
        return len(self.accessors) - 1

    def add_mesh(self, name: str, positions: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> None:
        """A mesh with the material of the same index."""
        attributes = {
            "POSITION": self.add(_in_gltf(positions), "VEC3", VERTICES, bounds=True),
            "NORMAL": self.add(_in_gltf(normals), "VEC3", VERTICES),
        }
        indices = self.add(faces.astype(np.uint32).ravel(), "SCALAR", INDICES)
        primitive = {"attributes": attributes, "indices": indices, "material": len(self.meshes)}
        self.meshes.append({"name": name, "primitives": [primitive]})

    def add_target(self, mesh: int, displacement: np.ndarray) -> None:
        """Displacements of a mesh's vertices in a frame."""
        accessor = self.add(_in_gltf(displacement), "VEC3", VERTICES, bounds=True)
        self.meshes[mesh]["primitives"][0].setdefault("targets", []).append({"POSITION": accessor})

    def document(self, clip: ExportClip) -> dict[str, Any]:
        colours = (("Body", BODY_COLOUR, 0.6), ("Hair", HAIR_COLOUR, 0.45))
        nodes = [{"name": mesh["name"], "mesh": index} for index, mesh in enumerate(self.meshes)]
        found: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"quaffure {version('quaffure')}"},
            "scene": 0,
            "scenes": [{"nodes": [*range(len(nodes))]}],
            "nodes": nodes,
            "meshes": self.meshes,
            "materials": [_material(*colour) for colour in colours],
        }
        if len(clip.frames) > 1:
            found["animations"] = [self._animation(clip)]
            for mesh in self.meshes:
                mesh["weights"] = [0.0] * (len(clip.frames) - 1)
        # Animations add arrays, so what says where they are comes last.
        return found | {"buffers": [{"byteLength": self.size}], "bufferViews": self.views, "accessors": self.accessors}

    def _animation(self, clip: ExportClip) -> dict[str, Any]:
        """The weight of a frame's target is 1 at its time, and that of all others 0; the first frame has none."""
        count = len(clip.frames)
        times = self.add((np.array(clip.frames) / clip.sequence.fps).astype(np.float32), "SCALAR", bounds=True)
        weights = self.add(np.eye(count, dtype=np.float32)[:, 1:].ravel(), "SCALAR")
        channels = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in range(len(self.meshes))]
        return {
            "name": str(clip.sequence.meta.get("motion", "drape")),
            "samplers": [{"input": times, "output": weights, "interpolation": "LINEAR"}],
            "channels": channels,
        }


def _add_meshes(asset: _Asset, clip: ExportClip, on_frame: Callable[[], object]) -> None:
    profile, width = clip.settings.mesh, clip.strand_width
    strands, body = clip.strands(0), np.array(clip.sequence.body_vertices[0])
    hair = strand_mesh_positions(strands, width, profile)
    asset.add_mesh("Body", body, _normals(body, clip.sequence.body_faces), clip.sequence.body_faces)
    faces = strand_mesh_faces(clip.strand_count, clip.point_count, profile)
    asset.add_mesh("Hair", hair, strand_mesh_normals(strands, profile), faces)
    on_frame()
    for frame in clip.frames[1:]:
        asset.add_target(0, clip.sequence.body_vertices[frame] - body)
        asset.add_target(1, strand_mesh_positions(clip.strands(frame), width, profile) - hair)
        on_frame()


def _normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "k 3"]) -> Float[np.ndarray, "v 3"]:
    normals = angle_weighted_vertex_normals(torch.from_numpy(vertices)[None], torch.from_numpy(faces).long())[0]
    return torch.nn.functional.normalize(normals, dim=-1).numpy()


def _material(name: str, colour: tuple[float, float, float], roughness: float) -> dict[str, Any]:
    surface = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": roughness}
    return {"name": name, "pbrMetallicRoughness": surface, "doubleSided": True}


def _in_gltf(vectors: Float[np.ndarray, "v 3"]) -> np.ndarray:
    x, y, z = np.asarray(vectors, dtype=np.float32).T
    return np.stack([x, z, -y], axis=1)
