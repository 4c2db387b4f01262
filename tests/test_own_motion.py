"""A body that was imported from a character, in that character's own animation."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from quaffure.body import BodyModel
from quaffure.body.body_origin import BodyOrigin
from quaffure.body.character import AnimationChannel, Character, CharacterAnimation
from quaffure.body.character_animation import frame_times, poses_at
from quaffure.body.own_motion import is_own, own_motion
from quaffure.character.skeleton import fit_skeleton
from tests.characters import character

FPS = 30.0


def moving(rest: Character, frames: int = 9) -> Character:
    """The character in an animation that turns every joint, moves the hips and begins after half a second."""
    nodes, random = rest.nodes, np.random.default_rng(2)
    times = 0.5 + np.arange(frames) / FPS
    share = np.sin(np.linspace(0, 2, frames))[:, None]
    channels = [
        AnimationChannel(node, "rotation", "LINEAR", times, (
            Rotation.from_quat(nodes.rotation[node]) * Rotation.from_rotvec(share * random.normal(0, 0.3, 3))
        ).as_quat()[:, None])
        for node in range(len(nodes))
    ]  # fmt: skip
    path = nodes.translation[0] + share * [40.0, -10.0, 25.0]
    channels.append(AnimationChannel(0, "translation", "LINEAR", times, path[:, None]))
    return replace(rest, animations=(CharacterAnimation("moves", tuple(channels)),))


def own_body(rest: Character, template: BodyModel) -> BodyModel:
    """The body of a character that has the template's surface."""
    skeleton, (mesh,) = fit_skeleton(rest, template), rest.meshes
    weights = skeleton.dense_weights(mesh.joints, mesh.weights)
    joints = np.argsort(-weights, axis=1)[:, :8]
    shares = np.take_along_axis(weights, joints, axis=1)
    vertices = skeleton.to_rest_pose(skeleton.in_body_space(mesh.vertices), weights)
    origin = BodyOrigin(
        1 / skeleton.metres, skeleton.body_from_file.T, skeleton.origin, rest.source, "", skeleton.joint_nodes
    )
    return replace(
        template,
        rest_vertices=torch.from_numpy(vertices).float(),
        rest_joints=torch.from_numpy(skeleton.rest_joints).float(),
        skin_joints=torch.from_numpy(joints),
        skin_weights=torch.from_numpy(shares / shares.sum(1, keepdims=True)).float(),
        origin=origin,
    )


@pytest.fixture(scope="module")
def imported(body: BodyModel) -> tuple[BodyModel, Character]:
    rest = character(body)
    return own_body(rest, body), moving(rest)


def scalp_vertices(own: BodyModel) -> np.ndarray:
    return np.unique(own.faces[own.scalp.faces].numpy())


def in_file(own: BodyModel, character: Character, world: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Points of the body's scalp, moved by the file's own skin at the places where they are at rest [file units]."""
    assert own.origin is not None
    (mesh,) = character.meshes
    rest = own.origin.file_from_body(own.rest_vertices[chosen].double().numpy())
    nearest = np.linalg.norm(mesh.vertices[None] - rest[:, None], axis=2).argmin(1)
    matrices = world[mesh.skin.nodes] @ mesh.skin.inverse_bind
    blended = np.einsum("vw,vwij->vij", mesh.weights[nearest], matrices[mesh.skin_joints[nearest]])
    return np.einsum("vij,vj->vi", blended[:, :3, :3], rest) + blended[:, :3, 3]


def test_the_scalp_is_where_the_file_has_it(imported: tuple[BodyModel, Character]) -> None:
    own, moved = imported
    assert is_own(own, moved)
    motion = own_motion(moved, moved.animations[0], own, FPS)
    assert (len(motion), motion.start) == (9, 0.5)
    posed = own.pose(motion.body_pose, torch.zeros(9, 10)).vertices + motion.translation[:, None]
    chosen = scalp_vertices(own)[::40]
    found = own.origin.file_from_body(posed[:, chosen].double().numpy())
    (poses,) = poses_at(moved, moved.animations[0], frame_times(moved.animations[0], FPS, 100))
    expected = np.stack([in_file(own, moved, world, chosen) for world in poses.world])
    millimetres = np.linalg.norm(found - expected, axis=2) * 1000 / own.origin.scale
    assert np.ptp(expected, axis=0).max() > 20  # centimetres
    assert millimetres.max() < 0.1
