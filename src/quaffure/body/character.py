"""A skinned character as its file describes it: nodes, meshes and what moves them, in the file's own space."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Nodes:
    """Nodes of a scene at rest, parents before children.

    Attributes:
        names: of each node.
        parents: index of each node's parent, -1 for a root.
        translations, rotations, scales: from a node to its parent at rest; rotations are quaternions xyzw.
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, " j"]
    translations: Float[np.ndarray, "j 3"]
    rotations: Float[np.ndarray, "j 4"]
    scales: Float[np.ndarray, "j 3"]

    def world(self) -> Float[np.ndarray, "j 4 4"]:
        """`scene_from_node` matrices at rest."""
        result = np.tile(np.eye(4), (len(self.names), 1, 1))
        result[:, :3, :3] = Rotation.from_quat(self.rotations).as_matrix() * self.scales[:, None]
        result[:, :3, 3] = self.translations
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                result[node] = result[parent] @ result[node]
        return result


@dataclass(frozen=True)
class SkinnedMesh:
    """A mesh and the nodes that move it.

    Attributes:
        name: of its node.
        vertices: in the file's scene, at rest [file units].
        faces: triangles.
        materials: name of the material of each face.
        joints, weights: nodes that move each vertex, and their shares, which sum to 1.
    """

    name: str
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]
    materials: tuple[str, ...]
    joints: Int[np.ndarray, "v w"]
    weights: Float[np.ndarray, "v w"]


@dataclass(frozen=True)
class Character:
    """A character of a file.

    Attributes:
        nodes: of the scene.
        meshes: those with a skin.
        animations: of its nodes.
        source: the file, for messages.
    """

    nodes: Nodes
    meshes: tuple[SkinnedMesh, ...]
    source: str
    animations: tuple[Any, ...] = field(default=())
