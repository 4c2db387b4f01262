"""Meshes of a glTF file, on the nodes of its scene: triangles, skin weights, morph targets and attributes of users."""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from quaffure.body.character import Skin, SkinnedMesh
from quaffure.errors import InputError
from quaffure.io.distinct_names import DistinctNames, one_line
from quaffure.io.gltf_accessor import GltfArrays
from quaffure.io.gltf_entry import Entry
from quaffure.io.gltf_nodes import GltfScene

TRIANGLES, STRIP, FAN = 4, 5, 6
BYTES_A_VERTEX = 300  # while a vertex is skinned
BYTES_A_FACE = 112  # three corners, shifted and joined, with the material
BYTES_A_SHARE = 32  # joint and weight, padded and joined
BYTES_A_MISSING_TARGET = 24  # zeros for each vertex, joined
BYTES_A_NUMBER = 12  # of an attribute of each vertex, zeros where a primitive lacks it, joined
MOST_SETS = 8
"""A vertex has four joints and weights in each set."""


class _Vertices(NamedTuple):
    """Vertices of a primitive; `None` what it does not have."""

    positions: Float[np.ndarray, "v 3"]
    skin_joints: Int[np.ndarray, "v w"]
    weights: Float[np.ndarray, "v w"]
    uv: Float[np.ndarray, "v 2"] | None
    targets: list[Float[np.ndarray, "v 3"] | None]
    attributes: dict[str, Float[np.ndarray, " v"]]


@dataclass
class _Surface:
    """The primitives of a mesh as they are read."""

    parts: dict[str, tuple[int, _Vertices]] = field(default_factory=dict)
    vertex_count: int = 0
    faces: list[Int[np.ndarray, "k 3"]] = field(default_factory=list)
    materials: list[Int[np.ndarray, " k"]] = field(default_factory=list)

    def add(self, primitive: Entry, arrays: GltfArrays, skin: Skin | None, material: int) -> None:
        # Exporters write one set of vertices for all materials of a mesh: then it is one here, too.
        key = repr((primitive.fields.get("attributes"), primitive.fields.get("targets")))
        if key not in self.parts:
            self.parts[key] = self.vertex_count, _vertices(primitive, arrays, skin)
            self.vertex_count += len(self.parts[key][1].positions)
        first, vertices = self.parts[key]
        faces = _faces(primitive, arrays, len(vertices.positions))
        self.faces.append(faces + first)
        self.materials.append(np.full(len(faces), material))

    @property
    def vertices(self) -> list[_Vertices]:
        return [vertices for _, vertices in self.parts.values()]

    @property
    def width(self) -> int:
        """Joints a vertex, as many as that with most has."""
        return max(part.weights.shape[1] for part in self.vertices)

    @property
    def attributes(self) -> list[str]:
        """Names of the attributes that any vertex has."""
        return list(dict.fromkeys(name for part in self.vertices for name in part.attributes))


def read_meshes(root: Entry, arrays: GltfArrays, scene: GltfScene, skins: list[Skin]) -> tuple[SkinnedMesh, ...]:
    """The meshes of the scene that have triangles.

    Raises:
        InputError: an array of another size than the others of its mesh, an index without a vertex or joint, a weight
            below 0, or a skin on a mesh without weights.
    """
    entries, materials = root.entries("meshes"), ["", *(entry.text("name") for entry in root.entries("materials"))]
    meshes = []
    for node, holder in enumerate(scene.entries):
        if "mesh" not in holder or not scene.shown[node]:
            continue
        entry, surface = entries[holder.index("mesh", len(entries))], _Surface()
        skin = skins[holder.index("skin", len(skins))] if "skin" in holder else None
        for primitive in entry.entries("primitives"):
            if primitive.integer("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN):
                material = primitive.index("material", len(materials) - 1) + 1 if "material" in primitive else 0
                surface.add(primitive, arrays, skin, material)
        if surface.faces:
            arrays.document.take(BYTES_A_SHARE * surface.vertex_count * surface.width, entry)
            arrays.document.take(BYTES_A_NUMBER * surface.vertex_count * len(surface.attributes), entry)
            meshes.append(_mesh(surface, (entry, holder), node, scene, skin, materials))
    return tuple(meshes)


def _mesh(
    surface: _Surface, entries: tuple[Entry, Entry], node: int, scene: GltfScene, skin: Skin | None,
    materials: list[str],
) -> SkinnedMesh:  # fmt: skip
    entry, holder = entries
    used, face_materials = np.unique(np.concatenate(surface.materials), return_inverse=True)
    targets = _morph_targets(entry, surface.vertices)
    bound = np.concatenate([part.positions for part in surface.vertices])
    skin_joints, weights = _blended(surface.vertices, surface.width)
    uv = [part.uv for part in surface.vertices if part.uv is not None]
    faces = np.concatenate(surface.faces)
    # Section 3.7.4 of the specification: a mirrored node turns the winding round; that of a skinned mesh has no effect.
    if skin is None and np.linalg.slogdet(scene.nodes.world[node, :3, :3]).sign < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    mesh = SkinnedMesh(
        name=scene.nodes.names[node],
        node=node,
        materials=tuple(materials[index] for index in used),
        face_materials=face_materials,
        bind_vertices=bound,
        vertices=bound,
        faces=faces,
        skin=Skin(np.array([node]), np.eye(4)[None]) if skin is None else skin,
        is_rigid=skin is None,
        skin_joints=skin_joints,
        weights=weights,
        uv=np.concatenate(uv) if len(uv) == len(surface.vertices) else None,
        morph_targets=targets,
        morph_weights=_morph_weights(entry, holder, len(targets)),
        attributes=_attributes(surface),
    )
    at_rest = mesh.posed(scene.nodes.world)
    if not np.isfinite(at_rest).all():
        entry.fail("vertices within 1e300 of one another", "others")
    return replace(mesh, vertices=at_rest)


def _vertices(primitive: Entry, arrays: GltfArrays, skin: Skin | None) -> _Vertices:
    attributes, accessors = primitive.required("attributes"), len(arrays.accessors)

    def read(entry: Entry, name: str, kind: str, rows: int | None = None) -> Float[np.ndarray, "v c"]:
        values = arrays.floats(entry.index(name, accessors), kind)
        if rows is not None and len(values) != rows:
            entry.fail(f"{rows} rows of {name}, as many as vertices", f"{len(values)}")
        return values

    positions = read(attributes, "POSITION", "VEC3")
    rows = len(positions)
    arrays.document.take(BYTES_A_VERTEX * rows, primitive)
    skin_joints, weights = np.zeros((rows, 1), np.int64), np.ones((rows, 1))
    if skin is not None:
        if "JOINTS_0" not in attributes or "WEIGHTS_0" not in attributes:
            attributes.fail("JOINTS_0 and WEIGHTS_0 on a mesh with a skin", ", ".join(map(repr, attributes.fields)))
        sets = [index for index in range(len(attributes.fields)) if f"WEIGHTS_{index}" in attributes]
        if len(sets) > MOST_SETS:
            attributes.fail(f"at most {MOST_SETS} sets of weights", f"{len(sets)}")
        arrays.document.take(4 * BYTES_A_SHARE * rows * len(sets), primitive)
        joints = [
            arrays.integers(attributes.index(f"JOINTS_{index}", accessors), ("VEC4",), len(skin.nodes))
            for index in sets
        ]
        if any(len(rows_of_joints) != rows for rows_of_joints in joints):
            attributes.fail(f"{rows} rows of JOINTS, as many as vertices", "others")
        weights = np.concatenate([read(attributes, f"WEIGHTS_{index}", "VEC4", rows) for index in sets], axis=1)
        skin_joints, weights = _normalized(np.concatenate(joints, axis=1), weights.astype(np.float64), attributes)
    uv = read(attributes, "TEXCOORD_0", "VEC2", rows) if "TEXCOORD_0" in attributes else None
    entries = primitive.entries("targets")
    missing = sum("POSITION" not in target for target in entries)
    arrays.document.take(BYTES_A_MISSING_TARGET * rows * missing, primitive)
    targets = [read(target, "POSITION", "VEC3", rows) if "POSITION" in target else None for target in entries]
    own = {}
    # Names of users' own attributes begin with an underscore (section 3.7.2.1 of the specification).
    for name in (name for name in attributes.fields if name.startswith("_")):
        with suppress(InputError):  # vectors, or numbers of any size: no reason to refuse a character
            own[one_line(name)] = read(attributes, name, "SCALAR", rows)[:, 0]
    return _Vertices(positions, skin_joints, weights, uv, targets, own)


def _normalized(
    joints: Int[np.ndarray, "v w"], weights: Float[np.ndarray, "v w"], entry: Entry
) -> tuple[Int[np.ndarray, "v w"], Float[np.ndarray, "v w"]]:
    """Weights that sum to 1; a vertex without any follows its first joint."""
    if weights.min() < 0:
        entry.fail("skin weights from 0 up", f"{weights.min():.3g}")
    total = weights.sum(axis=1, keepdims=True)
    weights[total[:, 0] == 0, 0] = 1.0
    return joints, weights / weights.sum(axis=1, keepdims=True)


def _faces(primitive: Entry, arrays: GltfArrays, vertices: int) -> Int[np.ndarray, "k 3"]:
    """Triangles of a primitive, of whichever of three modes."""
    indices = None
    if "indices" in primitive:
        accessor = primitive.index("indices", len(arrays.accessors))
        indices = arrays.integers(accessor, ("SCALAR",), vertices)[:, 0]
    mode = primitive.integer("mode", TRIANGLES)
    count = vertices if indices is None else len(indices)
    # Without indices, a primitive has no bytes in the file.
    arrays.document.take(BYTES_A_FACE * (count // 3 if mode == TRIANGLES else count), primitive)
    corners = np.arange(vertices) if indices is None else indices
    if mode == TRIANGLES:
        if len(corners) % 3:
            primitive.fail("three corners a triangle", f"{len(corners)} corners")
        return corners.reshape(-1, 3)
    if mode == FAN:
        return np.stack([np.broadcast_to(corners[:1], max(len(corners) - 2, 0)), corners[1:-1], corners[2:]], axis=1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    strip[1::2] = strip[1::2, [1, 0, 2]]  # every second triangle of a strip is stored the other way round
    return strip


def _blended(parts: list[_Vertices], width: int) -> tuple[Int[np.ndarray, "v w"], Float[np.ndarray, "v w"]]:
    """Joints and weights of all vertices, `width` of each."""

    def widened(values: np.ndarray) -> np.ndarray:
        return np.pad(values, ((0, 0), (0, width - values.shape[1])))

    joints = np.concatenate([widened(part.skin_joints) for part in parts])
    return joints, np.concatenate([widened(part.weights) for part in parts])


def _morph_targets(entry: Entry, parts: list[_Vertices]) -> dict[str, Float[np.ndarray, "v 3"]]:
    counts = {len(part.targets) for part in parts}
    if len(counts) > 1:
        entry.fail("as many morph targets on each part of a mesh", f"{min(counts)} and {max(counts)}")
    extras = entry.fields.get("extras")
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    targets: dict[str, Float[np.ndarray, "v 3"]] = {}
    distinct = DistinctNames()
    for index in range(counts.pop()):
        named = names[index] if isinstance(names, list) and index < len(names) else None
        name = distinct.add(named if isinstance(named, str) else f"target{index}")
        deltas = [part.targets[index] for part in parts]
        targets[name] = np.concatenate(
            [np.zeros_like(part.positions) if delta is None else delta for part, delta in zip(parts, deltas)]
        )
    return targets


def _attributes(surface: _Surface) -> dict[str, Float[np.ndarray, " v"]]:
    """Attributes of all vertices; 0 where a primitive lacks one."""
    return {
        name: np.concatenate(
            [part.attributes.get(name, np.zeros(len(part.positions), np.float32)) for part in surface.vertices]
        )
        for name in surface.attributes
    }


def _morph_weights(entry: Entry, holder: Entry, targets: int) -> tuple[float, ...]:
    """Weights of the morph targets at rest: those of the node before those of the mesh."""
    source = holder if "weights" in holder else entry
    weights = source.numbers("weights", ())
    if weights and len(weights) != targets:
        source.fail(f"{targets} weights of morph targets", f"{len(weights)}")
    return weights or (0.0,) * targets
