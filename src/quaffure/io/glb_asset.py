"""Arrays of a .glb, written as they come, and the document that says what they are."""

from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float, Float32, Int

from quaffure.errors import InputError

COMPONENTS = {"float32": 5126, "uint32": 5125, "uint16": 5123}
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES, INDICES = 34962, 34963


def in_gltf(vectors: Float[np.ndarray, "v 3"]) -> Float32[np.ndarray, "v 3"]:
    """Vectors in glTF's axes, y up: (x, y, z) is (x, z, -y)."""
    x, y, z = np.asarray(vectors, dtype=np.float32).T
    return np.stack([x, z, -y], axis=1)


class GlbAsset:
    """One scene with one animation.

    Args:
        binary: takes the arrays.
        path: for messages.
        most_bytes: that the arrays may take.
    """

    def __init__(self, binary: IO[bytes], path: Path, most_bytes: int) -> None:
        self._binary, self._path, self._most = binary, path, most_bytes
        self.size = 0
        self.meshes: list[dict[str, Any]] = []
        self.nodes: list[dict[str, Any]] = []
        self.skins: list[dict[str, Any]] = []
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._roots: list[int] = []
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """Write rows of numbers; the index of their accessor.

        Raises:
            InputError: more bytes than a file may have.
        """
        values = np.ascontiguousarray(values)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": values.nbytes}
        if target is not None:
            view["target"] = target
        self._views.append(view)
        accessor: dict[str, Any] = {"bufferView": len(self._views) - 1, "componentType": COMPONENTS[values.dtype.name]}
        accessor |= {"count": len(values), "type": KINDS[values.shape[1]]}
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self._accessors.append(accessor)
        padding = -values.nbytes % 4
        self._binary.write(values.data)
        self._binary.write(bytes(padding))
        self.size += values.nbytes + padding
        if self.size > self._most:
            raise InputError(self._path, "at most 4 GB of .glb (--points, --every)", "more")
        return len(self._accessors) - 1

    def add_material(self, name: str, colour: tuple[float, float, float], roughness: float) -> None:
        surface = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": roughness}
        self._materials.append({"name": name, "pbrMetallicRoughness": surface, "doubleSided": True})

    def add_mesh(
        self,
        name: str,
        positions: Float[np.ndarray, "v 3"],
        normals: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "k 3"],
    ) -> None:
        """A mesh with the material of the same index [m, axes of the drape]."""
        attributes = {
            "POSITION": self.add(in_gltf(positions), VERTICES, bounds=True),
            "NORMAL": self.add(in_gltf(normals), VERTICES),
        }
        indices = self.add(faces.astype(np.uint32).reshape(-1, 1), INDICES)
        primitive = {"attributes": attributes, "indices": indices, "material": len(self.meshes)}
        self.meshes.append({"name": name, "primitives": [primitive]})

    def add_attribute(self, mesh: int, name: str, values: np.ndarray) -> None:
        """Values of the vertices of a mesh."""
        self.meshes[mesh]["primitives"][0]["attributes"][name] = self.add(values, VERTICES)

    def add_target(self, mesh: int, displacement: Float[np.ndarray, "v 3"]) -> None:
        """Displacements of a mesh's vertices in a frame, which no frame shows yet."""
        targets = self.meshes[mesh]["primitives"][0].setdefault("targets", [])
        targets.append({"POSITION": self.add(in_gltf(displacement), VERTICES, bounds=True)})
        self.meshes[mesh]["weights"] = [0.0] * len(targets)

    def add_node(self, name: str, **values: Any) -> int:
        """A node of the scene's trees; its index."""
        self.nodes.append({"name": name, **values})
        return len(self.nodes) - 1

    def add_root(self, node: int) -> None:
        self._roots.append(node)

    def add_channel(self, node: int, path: str, times: Float32[np.ndarray, " f"], values: np.ndarray) -> None:
        """Change a property of a node over time [s]."""
        sampler = {
            "input": self.add(times[:, None], bounds=True),
            "output": self.add(values),
            "interpolation": "LINEAR",
        }
        self._samplers.append(sampler)
        self._channels.append({"sampler": len(self._samplers) - 1, "target": {"node": node, "path": path}})

    def document(self, animation: str) -> dict[str, Any]:
        """All that the file says; nothing may be added after it."""
        found: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"quaffure {version('quaffure')}"},
            "scene": 0,
            "scenes": [{"nodes": self._roots}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self._materials,
        }
        if self.skins:
            found["skins"] = self.skins
        if self._channels:
            found["animations"] = [{"name": animation, "samplers": self._samplers, "channels": self._channels}]
        return found | {
            "buffers": [{"byteLength": self.size}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
