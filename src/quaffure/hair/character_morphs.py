"""Morph targets that an animation of a character drives, on the surface of the body that was imported from it.

Every vertex of that surface is moved as the nearest point of the character's meshes at rest is. This holds for head,
neck and trunk, which have the same pose at rest in the file and in the body; arms and legs stay as they are.
"""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float, Int

from quaffure.body.body_model import BodyModel
from quaffure.body.character import Character, CharacterAnimation, SkinnedMesh
from quaffure.body.character_animation import poses_at
from quaffure.body.own_motion import TRUNK
from quaffure.body.surface_morphs import SurfaceMorphs
from quaffure.errors import InputError
from quaffure.hair.character_space import bind_points, closest_on_mesh, is_hair_mesh

REACH = 0.02
"""Distance from a mesh within which the surface is moved with it [m]; openings, which it closes, are narrower."""
LEAST_CHANGE = 1e-5
"""What a target has to move anything by, to count [m]."""
MOST_TARGETS = 1000


def surface_morphs(
    character: Character, animation: CharacterAnimation, body: BodyModel, times: Float[np.ndarray, " f"]
) -> SurfaceMorphs | None:
    """What an animation's morph targets change of the surface of the character's body; None where they change nothing.

    Args:
        body: imported from the character (`quaffure.body.own_motion.is_own`).
        times: of the frames [s].

    Raises:
        InputError: targets that move skin beyond `quaffure.body.surface_morphs.LARGEST_CHANGE`, or too many of them.
    """
    driven = {channel.node for channel in animation.channels if channel.path == "weights"}
    moving = [mesh for mesh in _bald(character) if mesh.node in driven and mesh.morph_targets]
    if not moving or body.origin is None:
        return None
    weights = _weights(character, animation, moving, times)
    near = _near(character, body)
    directions: list[Float[np.ndarray, "v 3"]] = []
    used: list[Float[np.ndarray, " f"]] = []
    for mesh in (mesh for mesh in moving if mesh in near):
        for target, direction in _directions(mesh, weights[mesh], near[mesh], character, body):
            if len(directions) == MOST_TARGETS:
                raise InputError(character.source, f"at most {MOST_TARGETS} morph targets that move the head", "more")
            directions.append(direction)
            used.append(weights[mesh][:, target])
    if not directions:
        return None
    morphs = SurfaceMorphs(
        torch.from_numpy(np.stack(directions)).float(), torch.from_numpy(np.stack(used, axis=1)).float()
    )
    morphs.check(character.source)
    return morphs


def _weights(
    character: Character, animation: CharacterAnimation, meshes: list[SkinnedMesh], times: Float[np.ndarray, " f"]
) -> dict[SkinnedMesh, Float[np.ndarray, "f t"]]:
    """Change of the weights from rest in every frame."""
    parts = [pose.morph_weights for pose in poses_at(character, animation, times)]
    return {
        mesh: np.concatenate([part[mesh.node] for part in parts]) - np.asarray(mesh.morph_weights) for mesh in meshes
    }


def _near(character: Character, body: BodyModel) -> dict[SkinnedMesh, Int[np.ndarray, " m"]]:
    """Vertices of the body's trunk and head by the mesh that is nearest to them, those far from all left out."""
    assert body.origin is not None
    vertices = np.flatnonzero(_trunk_share(body) > 0)
    points = body.origin.file_from_body(body.rest_vertices[vertices].double().numpy())
    meshes = _bald(character)
    distances = np.stack([closest_on_mesh(mesh, points)[2] for mesh in meshes]) / body.origin.scale
    nearest, is_near = distances.argmin(0), distances.min(0) < REACH
    return {mesh: vertices[(nearest == index) & is_near] for index, mesh in enumerate(meshes)}


def _directions(
    mesh: SkinnedMesh,
    weights: Float[np.ndarray, "f t"],
    vertices: Int[np.ndarray, " m"],
    character: Character,
    body: BodyModel,
) -> Iterator[tuple[int, Float[np.ndarray, "v 3"]]]:
    """The targets of a mesh that move any of these vertices, and how they do [m]."""
    origin = body.origin
    assert origin is not None
    world = character.nodes.world
    bound = bind_points(mesh, world, origin.file_from_body(body.rest_vertices[vertices].double().numpy()))
    share = _trunk_share(body)[vertices]
    for target, name in enumerate(mesh.morph_targets):
        most = float(np.abs(weights[:, target]).max())
        if most == 0:
            continue
        moved = share[:, None] * (bound.morphed_by(name, world) @ origin.rotation) / origin.scale
        if len(moved) and most * np.linalg.norm(moved, axis=1).max() > LEAST_CHANGE:
            direction = np.zeros((len(body.rest_vertices), 3))
            direction[vertices] = moved
            yield target, direction


def _bald(character: Character) -> list[SkinnedMesh]:
    """Meshes with faces, hair left out by its name."""
    return [mesh for mesh in character.meshes if len(mesh.faces) and not is_hair_mesh(mesh)]


def _trunk_share(body: BodyModel) -> Float[np.ndarray, " v"]:
    """Share of head, neck and trunk in every vertex."""
    joints = [body.joint_names.index(name) for name in TRUNK]
    share: Float[np.ndarray, " v"] = body.dense_skin_weights[:, joints].sum(1).double().numpy()
    return share
