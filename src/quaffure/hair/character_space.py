"""A drape in the scene of the character that its body was imported from: its axes, its unit, its place and its frames.

Every strand is moved by a similarity from the body's space, and then so that its root is where the file's own skin has
it: at rest the root is bound to the nearest triangle of the skin, whose joints and morph targets move it. So hair stays
on morphed heads, and on stretched bones, which the body does not have.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from quaffure.body.body_origin import BodyOrigin
from quaffure.body.character import Character, CharacterAnimation, SkinnedMesh
from quaffure.body.character_animation import CharacterPoses, poses_at
from quaffure.body.hair_names import is_hair_name
from quaffure.errors import InputError
from quaffure.geometry.signed_distance import closest_barycentric

NEAREST = 12
"""Vertices of the skin whose triangles are searched for the one nearest to a root."""
SKIN_DISTANCE = 0.005
"""From the skin, within which roots may be in the middle [m]; the surface of a body is within 2 mm of it."""

TOUCHING = 0.001
"""Distance from the skin below which a root is on it [m]: the triangles of a body's surface are up to 0.6 mm off a
scalp."""


@dataclass(frozen=True, eq=False)
class BoundPoints:
    """Points that a skinned mesh moves as if they were part of it.

    Attributes:
        mesh: the mesh.
        faces, barycentric: its nearest triangle to each of them at rest, and where on it.
        shares: share of every joint of the skin in each of them.
        bound: the points before they are skinned, in the mesh's own space.
    """

    mesh: SkinnedMesh
    faces: Int[np.ndarray, " m"]
    barycentric: Float[np.ndarray, "m 3"]
    shares: csr_matrix
    bound: Float[np.ndarray, "m 3"]

    def positions(
        self, world: Float[np.ndarray, "n 4 4"], morph_weights: Float[np.ndarray, " t"] | None
    ) -> Float[np.ndarray, "m 3"]:
        """The points in a pose [scene units].

        Args:
            world: `scene_from_node` of every node.
            morph_weights: of the morph targets; those at rest without.
        """
        points = self.bound
        if morph_weights is not None:
            changes = np.asarray(morph_weights) - np.asarray(self.mesh.morph_weights)
            for change, target in zip(changes, self.mesh.morph_targets.values()):
                if change:
                    corners = target[self.mesh.faces[self.faces]]
                    points = points + change * (self.barycentric[..., None] * corners).sum(1)
        matrices = _blended(self.mesh, self.shares, world)
        return np.einsum("mij,mj->mi", matrices[:, :3, :3], points) + matrices[:, :3, 3]

    def morphed_by(self, target: str, world: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "m 3"]:
        """How far a morph target of weight 1 moves the points [scene units].

        Args:
            world: `scene_from_node` of every node.
        """
        corners = self.mesh.morph_targets[target][self.mesh.faces[self.faces]]
        matrices = _blended(self.mesh, self.shares, world)
        return np.einsum("mij,mj->mi", matrices[:, :3, :3], (self.barycentric[..., None] * corners).sum(1))


def bind_points(
    mesh: SkinnedMesh, world: Float[np.ndarray, "n 4 4"], points: Float[np.ndarray, "m 3"], touching: float = 0.0
) -> BoundPoints:
    """Bind points to the nearest triangles of a mesh at rest.

    Args:
        world: `scene_from_node` of every node at rest.
        points: [scene units].
        touching: distance below which points are moved onto the mesh [scene units].
    """
    faces, barycentric, distance = closest_on_mesh(mesh, points)
    corners = mesh.faces[faces]
    places = (barycentric[..., None] * mesh.vertices[corners]).sum(1)
    points = np.where((distance < touching)[:, None], places, points)
    rows = np.repeat(np.arange(len(points)), 3 * mesh.weights.shape[1])
    values = (barycentric[..., None] * mesh.weights[corners]).ravel()
    columns = mesh.skin_joints[corners].ravel()
    shares = csr_matrix((values, (rows, columns)), shape=(len(points), len(mesh.skin.nodes)))
    matrices = _blended(mesh, shares, world)
    offset = points - matrices[:, :3, 3]
    # A joint of scale 0 has no inverse: its points are then as near as the skin can have them.
    bound = np.einsum("mij,mj->mi", np.linalg.pinv(matrices[:, :3, :3]), offset)
    return BoundPoints(mesh, faces, barycentric, shares, bound)


@dataclass(frozen=True, eq=False)
class AnimatedSkin:
    """The mesh of a character that hair grows on, in the frames of a drape.

    Attributes:
        character, animation: of the file.
        mesh: its skin.
        times: of the frames [s].
        still_node: index of a node that is kept where it is at rest, and the skin with it; None where the skin goes
            where the file has it.
    """

    character: Character
    animation: CharacterAnimation
    mesh: SkinnedMesh
    times: Float[np.ndarray, " f"]
    still_node: int | None = None
    _last: dict[int, CharacterPoses] = field(default_factory=dict)

    def vertices(self, frame: int) -> Float[np.ndarray, "v 3"]:
        """Vertices of the mesh in a frame [scene units]."""
        return self.mesh.posed(*self._pose(frame))

    def positions(self, points: BoundPoints, frame: int) -> Float[np.ndarray, "m 3"]:
        """Bound points in a frame [scene units]."""
        return points.positions(*self._pose(frame))

    def _pose(self, frame: int) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " t"] | None]:
        if frame not in self._last:
            self._last.clear()
            (poses,) = poses_at(self.character, self.animation, self.times[frame : frame + 1])
            if self.still_node is not None:
                path = poses.world[:, self.still_node, :3, 3] - self.character.nodes.world[self.still_node, :3, 3]
                poses.world[..., :3, 3] -= path[:, None]
            self._last[frame] = poses
        poses = self._last[frame]
        weights = poses.morph_weights.get(self.mesh.node)
        return poses.world[0], None if weights is None else weights[0]


@dataclass(frozen=True, eq=False)
class CharacterSpace:
    """Where a drape is in the scene of its body's character.

    Attributes:
        origin: the way from the body's space to the file's.
        start: time of the first frame in the file [s].
        skin: of the character in its own animation; None in another motion, which the file does not have.
    """

    origin: BodyOrigin
    start: float = 0.0
    skin: AnimatedSkin | None = None

    def in_place(self) -> "CharacterSpace":
        """The scene as seen by a drape whose body stays in place: the hips are where they are at rest, in the file's
        own animation, too."""
        if self.skin is None:
            return self
        hips = self.skin.character.nodes.names.index(self.origin.joint_nodes[0])
        return replace(self, skin=replace(self.skin, still_node=hips, _last={}))

    def bound(self, roots: Float[np.ndarray, "m 3"]) -> BoundPoints | None:
        """Roots at rest [m, the body's space], bound to the skin, and on it where they are as near as the surface that
        hair collides with is."""
        if self.skin is None:
            return None
        points, touching = self.origin.file_from_body(roots), TOUCHING * self.origin.scale
        return bind_points(self.skin.mesh, self.skin.character.nodes.world, points, touching)

    def placed(
        self, points: Float[np.ndarray, "v 3"], counts: Int[np.ndarray, " m"], roots: BoundPoints | None, frame: int
    ) -> Float[np.ndarray, "v 3"]:
        """Strands of a frame in the file's scene [file units].

        Args:
            points: of all strands one after another, roots first [m, the world of the drape].
            counts: of points of each strand.
            roots: bound to the skin, where there is one.
        """
        found = self.origin.file_from_body(points)
        if roots is None or self.skin is None:
            return found
        first = np.cumsum(counts) - counts
        return found + np.repeat(self.skin.positions(roots, frame) - found[first], counts, axis=0)


def skin_of(character: Character, origin: BodyOrigin, scalp: Float[np.ndarray, "p 3"]) -> SkinnedMesh:
    """The mesh that a body's scalp is on: the one nearest to it, hair left out by its name.

    Args:
        scalp: points of the body's scalp at rest [m].

    Raises:
        InputError: none is within a few millimetres.
    """
    points = origin.file_from_body(scalp)
    distances = {
        mesh: float(np.median(closest_on_mesh(mesh, points)[2])) / origin.scale
        for mesh in character.meshes
        if len(mesh.faces)
    }
    bald = [mesh for mesh in distances if not is_hair_mesh(mesh)]
    nearest = min(bald or distances, key=lambda mesh: distances[mesh], default=None)
    if nearest is None or distances[nearest] > SKIN_DISTANCE:
        found = "no mesh" if nearest is None else f"{nearest.name}, {1e3 * distances[nearest]:.0f} mm away"
        raise InputError(character.source, f"a mesh within {1e3 * SKIN_DISTANCE:g} mm of the scalp of its body", found)
    return nearest


def is_hair_mesh(mesh: SkinnedMesh) -> bool:
    """Whether the mesh or all of its materials are called as hair is."""
    return is_hair_name(mesh.name) or (bool(mesh.materials) and all(map(is_hair_name, mesh.materials)))


def closest_on_mesh(
    mesh: SkinnedMesh, points: Float[np.ndarray, "m 3"]
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Triangle of a mesh at rest that is nearest to each point, barycentric coordinates there, and the distance."""
    used = np.unique(mesh.faces)
    count = min(NEAREST, len(used))
    near = used[cKDTree(mesh.vertices[used]).query(points, k=[*range(1, count + 1)])[1]]
    incident = csr_matrix(
        (np.ones(mesh.faces.size, bool), (mesh.faces.ravel(), np.repeat(np.arange(len(mesh.faces)), 3))),
        shape=(len(mesh.vertices), len(mesh.faces)),
    )
    chosen = csr_matrix(
        (np.ones(near.size, bool), (np.repeat(np.arange(len(points)), count), near.ravel())),
        shape=(len(points), len(mesh.vertices)),
    )
    pairs = (chosen @ incident).tocoo()
    triangles = torch.from_numpy(mesh.vertices[mesh.faces[pairs.col]])
    weights = closest_barycentric(torch.from_numpy(points[pairs.row]), triangles)[0]
    places = (weights[..., None] * triangles).sum(1).numpy()
    distance = np.linalg.norm(places - points[pairs.row], axis=1)
    order = np.lexsort((distance, pairs.row))
    first = order[np.searchsorted(pairs.row[order], np.arange(len(points)))]
    return pairs.col[first].astype(np.int64), weights.numpy()[first], distance[first]


def _blended(mesh: SkinnedMesh, shares: csr_matrix, world: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "m 4 4"]:
    matrices = world[mesh.skin.nodes] @ mesh.skin.inverse_bind
    return (shares @ matrices.reshape(-1, 16)).reshape(-1, 4, 4)
