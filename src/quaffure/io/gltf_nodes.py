"""Nodes, skins and the scene of a glTF file."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from quaffure.body.character import CharacterNodes, Skin, decomposed, parents_first
from quaffure.io.character_limits import MOST_NODES
from quaffure.io.distinct_names import DistinctNames
from quaffure.io.gltf_accessor import GltfArrays
from quaffure.io.gltf_entry import Entry

IDENTITY = tuple(float(number) for number in np.eye(4).flatten())


@dataclass(frozen=True, eq=False)
class GltfScene:
    """The nodes of a file in an order in which parents come first.

    Attributes:
        nodes: all of them.
        entries: the document's objects, in the same order.
        order: for each node of the document, its place in that order.
        shown: whether each node is part of the scene.
    """

    nodes: CharacterNodes
    entries: list[Entry]
    order: Int[np.ndarray, " n"]
    shown: list[bool]


def read_scene(root: Entry) -> GltfScene:
    """The nodes of a document.

    Raises:
        InputError: no nodes or too many, a node with two parents or below itself, or a transform that is none.
    """
    entries = root.entries("nodes")
    if not 1 <= len(entries) <= MOST_NODES:
        root.fail(f"1 to {MOST_NODES} nodes", f"{len(entries)}")
    children = [entry.indices("children", len(entries)) for entry in entries]
    parents = np.full(len(entries), -1)
    for index, below in enumerate(children):
        for child in below:
            if parents[child] >= 0:
                entries[child].fail("a node with one parent", "two")
            parents[child] = index
    sequence = parents_first(parents, children)
    if len(sequence) < len(entries):
        root.fail("nodes in trees", "nodes below themselves")
    order = np.empty(len(entries), dtype=np.int64)
    order[sequence] = np.arange(len(sequence))
    roots = _scene_roots(root, parents)
    shown: list[bool] = []
    for index in sequence:
        parent = int(parents[index])
        shown.append(shown[order[parent]] if parent >= 0 else index in roots)
    ordered = [entries[index] for index in sequence]
    above = np.array([order[parents[index]] if parents[index] >= 0 else -1 for index in sequence])
    translation, rotation, scale = map(np.array, zip(*map(_transform, ordered)))
    nodes = CharacterNodes(_names(ordered, sequence), above, translation, rotation, scale)
    if not np.isfinite(nodes.world).all():
        root.fail("nodes within 1e300 of one another", "others")
    return GltfScene(nodes, ordered, order, shown)


def read_skins(root: Entry, arrays: GltfArrays, scene: GltfScene) -> list[Skin]:
    """The skins of a document.

    Raises:
        InputError: one without joints, or with another number of matrices than joints.
    """
    return [_skin(entry, arrays, scene) for entry in root.entries("skins")]


def _skin(entry: Entry, arrays: GltfArrays, scene: GltfScene) -> Skin:
    joints = entry.indices("joints", len(scene.entries))
    if not joints:
        entry.fail("joints", "none")
    inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in entry:
        values = arrays.floats(entry.index("inverseBindMatrices", len(arrays.accessors)), "MAT4")
        if len(values) < len(joints):
            entry.fail(f"{len(joints)} inverse bind matrices", f"{len(values)}")
        inverse_bind = values[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
        inverse_bind[:, 3] = (0, 0, 0, 1)
    return Skin(scene.order[joints], inverse_bind)


def _scene_roots(root: Entry, parents: Int[np.ndarray, " n"]) -> set[int]:
    """Root nodes of the scene that the file shows; of all nodes where it has no scenes."""
    scenes = root.entries("scenes")
    if not scenes:
        return {int(index) for index in np.flatnonzero(parents < 0)}
    return set(scenes[root.index("scene", len(scenes)) if "scene" in root else 0].indices("nodes", len(parents)))


def _names(entries: list[Entry], indices: list[int]) -> tuple[str, ...]:
    """Names of nodes, made different where they are not."""
    names = DistinctNames()
    return tuple(names.add(entry.text("name").strip() or f"node{index}") for entry, index in zip(entries, indices))


def _transform(entry: Entry) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"], Float[np.ndarray, "3"]]:
    """Translation, rotation (`xyzw`) and scale of a node."""
    if "matrix" in entry:
        try:
            return decomposed(np.array(entry.numbers("matrix", IDENTITY)).reshape(4, 4).T)
        except ValueError as error:
            entry.fail("a matrix that turns and scales", str(error))
    rotation = np.array(entry.numbers("rotation", (0.0, 0.0, 0.0, 1.0)))
    length = float(np.linalg.norm(rotation))
    if length < 1e-6:
        entry.fail("a rotation of length 1", f"{length:.3g}")
    translation, scale = entry.numbers("translation", (0.0, 0.0, 0.0)), entry.numbers("scale", (1.0, 1.0, 1.0))
    return np.array(translation), rotation / length, np.array(scale)
