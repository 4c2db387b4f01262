"""A character of another program: its nodes, the meshes that they move, and its animations, as a glTF file has them.

Everything is in the axes and the unit of the file's scene. That of glTF is metres, y up, facing +z, to which FBX is
converted.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from quaffure.errors import InputError

SHEAR_TOLERANCE = 1e-3
"""Largest cosine between the axes of a node's matrix, which may turn and scale but not shear."""


@dataclass(frozen=True, eq=False)
class CharacterNodes:
    """The nodes of a scene at rest: joints, what holds them, and what meshes hang on.

    Attributes:
        names: all different.
        parents: index of each node's parent, -1 of a root; parents come before their children.
        translation: from the parent's origin, in its frame [scene units].
        rotation: unit quaternions `xyzw`, relative to the parent.
        scale: factors along the node's own axes.
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, " n"]
    translation: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    scale: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def world(self) -> Float[np.ndarray, "n 4 4"]:
        """`scene_from_node` of every node at rest."""
        return world_matrices(self.parents, local_matrices(self.translation, self.rotation, self.scale))

    def ancestors(self, node: int) -> list[int]:
        """The node itself, its parent, and so on to the root."""
        chain = [node]
        while self.parents[chain[-1]] >= 0:
            chain.append(int(self.parents[chain[-1]]))
        return chain


@dataclass(frozen=True, eq=False)
class Skin:
    """Joints that move a mesh.

    Attributes:
        nodes: their indices among the nodes.
        inverse_bind: `joint_from_mesh` when the mesh was bound to them. The matrix of joint j in a pose is
            `scene_from_node[nodes[j]] @ inverse_bind[j]`; where the mesh itself hangs does not matter.
    """

    nodes: Int[np.ndarray, " s"]
    inverse_bind: Float[np.ndarray, "s 4 4"]


@dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """Triangles that joints move, by linear blend skinning.

    Attributes:
        name: of its node.
        node: index of the node that it hangs on.
        materials: names, "" without one.
        face_materials: index among `materials` of each face.
        bind_vertices: in the mesh's own space, before they are skinned.
        vertices: at rest [scene units], skinned by the nodes' rest transforms.
        faces: counterclockwise from outside.
        skin: the joints. A mesh without a skin of its own has one joint, its node.
        is_rigid: whether it is a mesh without a skin of its own.
        skin_joints: indices among `skin.nodes`.
        weights: their shares, which sum to 1.
        uv: texture coordinates, v down, where the file has them.
        morph_targets: by name, differences from `bind_vertices`.
        morph_weights: their weights at rest.
        attributes: further numbers of the vertices, by the names that the file gives them, such as `_SCALP`.
    """

    name: str
    node: int
    materials: tuple[str, ...]
    face_materials: Int[np.ndarray, " k"]
    bind_vertices: Float[np.ndarray, "v 3"]
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]
    skin: Skin
    is_rigid: bool
    skin_joints: Int[np.ndarray, "v w"]
    weights: Float[np.ndarray, "v w"]
    uv: Float[np.ndarray, "v 2"] | None = None
    morph_targets: dict[str, Float[np.ndarray, "v 3"]] = field(default_factory=dict)
    morph_weights: tuple[float, ...] = ()
    attributes: dict[str, Float[np.ndarray, " v"]] = field(default_factory=dict)

    @property
    def joints(self) -> Int[np.ndarray, "v w"]:
        """Nodes that move each vertex."""
        return self.skin.nodes[self.skin_joints]

    def morphed(self, weights: Float[np.ndarray, " t"]) -> Float[np.ndarray, "v 3"]:
        """`bind_vertices` with its morph targets added, each times its weight."""
        vertices = np.array(self.bind_vertices, dtype=np.float64)
        for weight, target in zip(weights, self.morph_targets.values()):
            if weight:
                vertices += weight * target
        return vertices

    def posed(
        self, world: Float[np.ndarray, "n 4 4"], morph_weights: Float[np.ndarray, " t"] | None = None
    ) -> Float[np.ndarray, "v 3"]:
        """Vertices in a pose [scene units].

        Args:
            world: `scene_from_node` of every node.
            morph_weights: of the morph targets; those at rest without.
        """
        bound = self.morphed(np.asarray(self.morph_weights if morph_weights is None else morph_weights))
        return skinned(bound, world[self.skin.nodes] @ self.skin.inverse_bind, self.skin_joints, self.weights)


@dataclass(frozen=True, eq=False)
class AnimationChannel:
    """One property of one node over time.

    Attributes:
        node: its index.
        path: `translation`, `rotation` (`xyzw`), `scale` or `weights` (of the morph targets of its mesh).
        interpolation: `STEP`, `LINEAR` or `CUBICSPLINE`.
        times: of the keys [s], not decreasing.
        values: one row a key; with CUBICSPLINE three: incoming tangent, value, outgoing tangent [per second].
    """

    node: int
    path: str
    interpolation: str
    times: Float[np.ndarray, " t"]
    values: Float[np.ndarray, "t r c"]


@dataclass(frozen=True, eq=False)
class CharacterAnimation:
    """A clip of a character: channels that run together."""

    name: str
    channels: tuple[AnimationChannel, ...]

    @property
    def span(self) -> tuple[float, float]:
        """Times of the first and the last key [s]."""
        return min(float(c.times[0]) for c in self.channels), max(float(c.times[-1]) for c in self.channels)


@dataclass(frozen=True, eq=False)
class Character:
    """What a file holds of a character.

    Attributes:
        nodes: all nodes of the file.
        meshes: those of its scene.
        animations: in the order of the file; names differ.
        source: the file, for messages.
    """

    nodes: CharacterNodes
    meshes: tuple[SkinnedMesh, ...]
    animations: tuple[CharacterAnimation, ...]
    source: str

    def mesh(self, name: str) -> SkinnedMesh:
        """A mesh by its name.

        Raises:
            InputError: none of that name; lists those that there are.
        """
        for mesh in self.meshes:
            if mesh.name == name:
                return mesh
        known = ", ".join(mesh.name for mesh in self.meshes) or "none"
        raise InputError(self.source, f"a mesh '{name}'", f"the meshes {known}")

    @property
    def joints(self) -> list[int]:
        """Nodes that are joints of a skin, and all above them, in order; every node where nothing has a skin."""
        moving = {int(node) for mesh in self.meshes if not mesh.is_rigid for node in mesh.skin.nodes}
        if not moving:
            return list(range(len(self.nodes)))
        return sorted({above for node in moving for above in self.nodes.ancestors(node)})


def parents_first(parents: Int[np.ndarray, " n"], children: list[list[int]]) -> list[int]:
    """Nodes from the roots down, each subtree in one piece; without those that are below themselves.

    Args:
        parents: of every node, -1 of a root.
        children: of every node, in order.
    """
    sequence: list[int] = []
    waiting = [int(index) for index in np.flatnonzero(parents < 0)][::-1]  # files may be nested deep: no recursion
    while waiting:
        sequence.append(waiting.pop())
        waiting.extend(reversed(children[sequence[-1]]))
    return sequence


def local_matrices(
    translation: Float[np.ndarray, "*f n 3"], rotation: Float[np.ndarray, "*f n 4"], scale: Float[np.ndarray, "*f n 3"]
) -> Float[np.ndarray, "*f n 4 4"]:
    """`parent_from_node` of translations, rotations (unit quaternions `xyzw`) and scales."""
    matrices = np.zeros((*translation.shape[:-1], 4, 4))
    turned = Rotation.from_quat(rotation.reshape(-1, 4)).as_matrix().reshape(*rotation.shape[:-1], 3, 3)
    matrices[..., :3, :3] = turned * scale[..., None, :]
    matrices[..., :3, 3] = translation
    matrices[..., 3, 3] = 1.0
    return matrices


def decomposed(
    matrix: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"], Float[np.ndarray, "3"]]:
    """Translation, rotation (`xyzw`) and scale of a matrix; of a mirror image the first scale is below 0.

    Raises:
        ValueError: it has no inverse, or it shears; says which.
    """
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if scale.min() < 1e-12:
        raise ValueError("one without an inverse")
    axes = matrix[:3, :3] / scale
    if np.linalg.det(axes) < 0:
        axes[:, 0], scale[0] = -axes[:, 0], -scale[0]
    if np.abs(axes.T @ axes - np.eye(3)).max() > SHEAR_TOLERANCE:
        raise ValueError("one that shears")
    return matrix[:3, 3].copy(), Rotation.from_matrix(axes).as_quat(), scale


def world_matrices(
    parents: Int[np.ndarray, " n"], local: Float[np.ndarray, "*f n 4 4"]
) -> Float[np.ndarray, "*f n 4 4"]:
    """`scene_from_node` of every node, from `parent_from_node`; infinite where factors multiply beyond any size."""
    world = local.copy()
    with np.errstate(all="ignore"):
        for node, parent in enumerate(parents):
            if parent >= 0:
                world[..., node, :, :] = world[..., parent, :, :] @ local[..., node, :, :]
    return world


def skinned(
    vertices: Float[np.ndarray, "v 3"],
    matrices: Float[np.ndarray, "s 4 4"],
    joints: Int[np.ndarray, "v w"],
    weights: Float[np.ndarray, "v w"],
) -> Float[np.ndarray, "v 3"]:
    """Linear blend skinning: the mean of a vertex moved by each of its joints' matrices, by their weights."""
    posed = np.zeros((len(vertices), 3))
    with np.errstate(all="ignore"):
        for joint, weight in zip(joints.T, weights.T):
            moved = np.einsum("vij,vj->vi", matrices[joint, :3, :3], vertices) + matrices[joint, :3, 3]
            posed += weight[:, None] * moved
    return posed
