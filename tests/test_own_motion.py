"""A body that was imported from a character, in that character's own animation."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from quaffure import InputError, load_groom
from quaffure.body import AnimationChannel, BodyModel, Character, Motion, frame_times, poses_at
from quaffure.body.body_origin import BodyOrigin
from quaffure.body.character import CharacterAnimation
from quaffure.body.own_motion import is_own, own_motion
from quaffure.character import ImportSettings, Triangles, fit_skeleton
from quaffure.character.collision_surface import closest_on, distance_to
from quaffure.character.import_body import import_body
from quaffure.hair import (
    AnimatedSkin,
    CharacterSpace,
    DrapeSequence,
    ExportClip,
    PlacedStrands,
    StrandAttributes,
    Strands,
    root_positions,
)
from quaffure.hair.character_space import bind_points
from quaffure.hair.groom_binding import GroomBinding, Skeleton
from quaffure.hair.placed_clip import placed_clip
from quaffure.io import load_source, write_groom
from tests.characters import REFERENCE_GRID, character

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


@pytest.mark.parametrize(("scale", "said"), [(1.5, True), (1.005, False)])
def test_an_animated_scale_is_said(imported: tuple[BodyModel, Character], scale: float, said: bool) -> None:
    own, moved = imported
    (animation,) = moved.animations
    node = moved.nodes.names.index("mixamorig:Head")
    values = np.stack([np.ones((1, 3)), np.full((1, 3), scale)])
    grown = AnimationChannel(node, "scale", "LINEAR", np.array([0.5, 0.7]), values)
    animation = replace(animation, channels=(*animation.channels, grown))
    notes = own_motion(replace(moved, animations=(animation,)), animation, own, FPS).notes
    assert notes == (
        ("scale of Head is animated, by up to 50 %: hair collides with the body at its size at rest",) * said
    )
    assert own_motion(moved, moved.animations[0], own, FPS).notes == ()


def drape_of(own: BodyModel, motion: Motion, roots: np.ndarray) -> DrapeSequence:
    """Straight strands on vertices of the body, moved with them."""
    posed = own.pose(motion.body_pose, torch.zeros(len(motion), 10)).vertices + motion.translation[:, None]
    steps = torch.tensor([0.0, 0.05, 0.1])[:, None] * torch.tensor([0.0, 0.0, 1.0])
    strands = (posed[:, roots, None] + steps).numpy()
    return DrapeSequence(
        strands=strands, posed=strands, rest_lengths=np.full((len(roots), 2), 0.05), body_vertices=posed.numpy(),
        body_faces=own.faces.numpy().astype(np.int32), body_pose=motion.body_pose.numpy(), body_shape=np.zeros(10),
        fps=motion.fps, body_translation=motion.translation.numpy(),
    )  # fmt: skip


def binding_of(own: BodyModel, roots: np.ndarray) -> GroomBinding:
    rest = own.rest_vertices.numpy()
    strands = rest[roots, None] + np.float32([[0, 0, 0], [0, 0, 0.05], [0, 0, 0.1]])
    skeleton = Skeleton(own.joint_names, own.joint_parents, own.rest_joints.double().numpy(), own.skin_joints.numpy(),
                        own.skin_weights.numpy())  # fmt: skip
    return GroomBinding(strands, rest, np.zeros((len(roots), 2)), np.zeros((len(own.faces), 3, 2)), skeleton)


def stretched(moved: Character) -> Character:
    """Bones of the spine and the neck that also stretch, and a morph target that widens the head."""
    nodes, (clip,), (mesh,) = moved.nodes, moved.animations, moved.meshes
    times = clip.channels[0].times
    channels = list(clip.channels)
    for name in ("mixamorig:Neck", "mixamorig:Head", "mixamorig:Spine1"):
        node = nodes.names.index(name)
        path = nodes.translation[node] * np.linspace(1.0, 1.3, len(times))[:, None]
        channels.append(AnimationChannel(node, "translation", "LINEAR", times, path[:, None]))
    weights = np.linspace(0, 1, len(times))[:, None, None]
    channels.append(AnimationChannel(mesh.node, "weights", "LINEAR", times, weights))
    widened = 0.1 * mesh.bind_vertices * [1.0, 0.0, 0.0]
    mesh = replace(mesh, morph_targets={"wide": widened}, morph_weights=(0.0,))
    return replace(moved, meshes=(mesh,), animations=(CharacterAnimation("stretches", tuple(channels)),))


def test_points_are_bound_to_a_joint_of_scale_0(imported: tuple[BodyModel, Character]) -> None:
    """A head that its animation shows and that is hidden at rest."""
    rest = imported[1]
    nodes, (mesh,) = rest.nodes, rest.meshes
    scale = np.array(nodes.scale)
    scale[nodes.names.index("mixamorig:Head")] = 0.0
    hidden = replace(nodes, scale=scale)
    points = mesh.posed(hidden.world)[scalp_vertices(imported[0])[::60]]
    bound = bind_points(replace(mesh, vertices=mesh.posed(hidden.world)), hidden.world, points)
    assert np.isfinite(bound.bound).all()
    np.testing.assert_allclose(bound.positions(hidden.world, None), points, atol=1e-6)


@pytest.mark.parametrize("change", [lambda moved: moved, stretched], ids=["turns", "stretches and morphs"])
def test_one_root_is_where_the_file_has_its_vertex(
    change: Callable[[Character], Character], imported: tuple[BodyModel, Character], tmp_path: Path
) -> None:
    """Through the whole way, to the points that are written: within 0.1 mm in every frame."""
    own, moved = imported[0], change(imported[1])
    (animation,), (mesh,) = moved.animations, moved.meshes
    motion = own_motion(moved, animation, own, FPS)
    chosen = scalp_vertices(own)[::60]
    times = motion.start + np.arange(len(motion)) / FPS
    skin = AnimatedSkin(moved, animation, mesh, times)
    clip = placed_clip(
        ExportClip(drape_of(own, motion, chosen), binding=binding_of(own, chosen)),
        CharacterSpace(own.origin, 0.5, skin),
    )
    (poses,) = poses_at(moved, animation, times)
    for frame in range(len(motion)):
        weights = poses.morph_weights[mesh.node][frame] if mesh.morph_targets else None
        expected = mesh.posed(poses.world[frame], weights)[chosen]
        found = clip.points(frame).reshape(-1, 3, 3)
        millimetres = np.linalg.norm(found[:, 0] - expected, axis=1) * 1000 / own.origin.scale
        assert millimetres.max() < 0.1
        np.testing.assert_allclose(clip.strands(frame)[:, 0], expected, atol=0.01)
        np.testing.assert_allclose(clip.body_vertices(frame), mesh.posed(poses.world[frame], weights), atol=0.01)
        # Up in the body's space is y in the file, and 5 cm are 5 of its units.
        np.testing.assert_allclose(found[:, 1] - found[:, 0], [[0, 5, 0]] * len(chosen), atol=1e-2)
    arrays = clip.file_arrays()
    moved_back = (
        arrays["file_scale"] * clip.sequence.strands[4] @ arrays["file_rotation"].T + arrays["file_translation"]
    )
    moved_back = moved_back + arrays["root_offset"][4][:, None]
    np.testing.assert_allclose(moved_back.reshape(-1, 3), clip.points(4), atol=1e-3)
    assert (clip.up_axis, clip.start) == ("y", 0.5)
    turned = replace(clip, is_z_up=True).points(3)
    np.testing.assert_allclose(turned, clip.points(3)[:, [0, 2, 1]] * [1, -1, 1])
    np.testing.assert_allclose(clip.widths, 100 * clip.inner.widths, rtol=1e-5)
    np.testing.assert_array_equal(clip.body_faces, mesh.faces)


def test_roots_beside_the_skin_are_bound_onto_it(imported: tuple[BodyModel, Character]) -> None:
    """The surface of an import is up to 0.6 mm off the file's skin; roots that float 3 mm above it were made so."""
    own, moved = imported
    (animation,), (mesh,) = moved.animations, moved.meshes
    assert own.origin is not None
    chosen = scalp_vertices(own)[::60]
    outwards = torch.nn.functional.normalize(own.rest_vertices[chosen] - own.rest_vertices[chosen].mean(0), dim=1)
    times = frame_times(animation, FPS, 100)
    space = CharacterSpace(own.origin, 0.5, AnimatedSkin(moved, animation, mesh, times))
    (poses,) = poses_at(moved, animation, times)
    for metres, expected in ((0.0005, 0.0), (0.003, 3.0)):
        roots = (own.rest_vertices[chosen] + metres * outwards).double().numpy()
        bound = space.bound(roots)
        assert bound is not None
        for frame in range(len(times)):
            skin = Triangles(mesh.posed(poses.world[frame]), mesh.faces)
            placed = space.placed(roots, np.ones(len(roots), int), bound, frame)
            millimetres = 1000 / own.origin.scale * distance_to(placed, skin)
            assert np.median(millimetres) == pytest.approx(expected, abs=0.5 if expected else 0.02)
            assert millimetres.max() < (3.2 if expected else 0.1)


@pytest.mark.slow
def test_roots_of_an_import_are_where_the_skin_of_its_file_is(body: BodyModel) -> None:
    """A body by `import_body`, whose surface is another mesh than the file's: within 0.1 mm in every frame."""
    rest = character(body)
    moved = moving(rest)
    own = import_body(rest, "", body, ImportSettings(cell=2 * REFERENCE_GRID)).body
    (animation,), (mesh,) = moved.animations, moved.meshes
    assert own.origin is not None
    motion = own_motion(moved, animation, own, FPS)
    groom = load_groom("bob", own).thinned(80)
    at_rest = own.origin.file_from_body(groom.rest_strands[:, 0].double().numpy())
    faces, weights, places = closest_on(at_rest, Triangles(mesh.vertices, mesh.faces))
    near = np.linalg.norm(places - at_rest, axis=1) < 0.1  # centimetres
    assert near.mean() > 0.9
    space = CharacterSpace(own.origin, motion.start, AnimatedSkin(moved, animation, mesh, motion.times))
    bound = space.bound(groom.rest_strands[:, 0].double().numpy())
    posed = own.pose(motion.body_pose, torch.zeros(len(motion), 10)).vertices + motion.translation[:, None]
    roots = root_positions(groom, posed, own).double().numpy()
    (poses,) = poses_at(moved, animation, motion.times)
    for frame in range(len(motion)):
        found = space.placed(roots[frame], np.ones(len(groom), int), bound, frame)
        expected = (weights[..., None] * mesh.posed(poses.world[frame])[mesh.faces[faces]]).sum(1)
        assert 10 * np.linalg.norm(found - expected, axis=1)[near].max() < 0.1  # millimetres


def test_every_strand_of_a_source_is_where_its_groom_is(
    imported: tuple[BodyModel, Character], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Strands that were made on the character, in centimetres, stay where they are, and so does their source."""
    own = imported[0]
    assert own.origin is not None
    roots = own.rest_vertices[scalp_vertices(own)[::2]].double().numpy()
    centre = roots.mean(0) - [0.0, 0.0, 0.1]
    outwards = (roots - centre) / np.linalg.norm(roots - centre, axis=1, keepdims=True)
    expected = (roots[:, None] + np.linspace(0, 0.05, 24)[:, None] * outwards[:, None]).reshape(-1, 3)
    points = own.origin.file_from_body(expected).astype(np.float32)
    width = np.full(len(points), 0.01, dtype=np.float32)
    made = Strands(points, np.full(len(roots), 24), "made.hair", attributes=StrandAttributes(width=width))
    monkeypatch.setattr("quaffure.io.load_groom.read_strands", lambda path: made)
    read, source = load_groom("made.hair", own), load_source("made.hair", own)
    distance, _ = cKDTree(source.points[source.starts]).query(read.rest_strands[:, 0].numpy())
    assert distance.max() < 1e-4
    np.testing.assert_allclose(source.points, expected, atol=1e-5)
    assert source.attributes.width is not None
    np.testing.assert_allclose(source.attributes.width, 1e-4, rtol=1e-5)


def test_the_source_of_a_carried_groom_is_refused(
    imported: tuple[BodyModel, Character], body: BodyModel, tmp_path: Path
) -> None:
    """The groom of another body is carried to this one, but its source would stay on the other head."""
    groom, path = load_groom("bob", body).thinned(50), tmp_path / "shipped.npz"
    points = groom.rest_strands.flatten(0, 1).numpy()
    whole = np.zeros(50, bool)
    write_groom(path, groom, PlacedStrands(points, np.full(50, 24), whole, ~whole, StrandAttributes()))
    assert len(load_source(path, body)) == 50
    apart = replace(imported[0], rest_vertices=imported[0].rest_vertices * 1.1)
    with pytest.raises(InputError, match="a groom file of another body, whose source stays on it"):
        load_source(path, apart)
