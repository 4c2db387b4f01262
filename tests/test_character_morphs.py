"""Morph targets of a character's animation move the surface that hair collides with, and so the hair."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import quaffure as qf
from quaffure import InputError
from quaffure.body import (
    AnimationChannel,
    BodyModel,
    Character,
    MlsBodyConfig,
    Motion,
    head_frame_body,
    head_frame_body_reference,
    poses_at,
    resample,
)
from quaffure.body.body_model import check_offsets
from quaffure.body.character import CharacterAnimation
from quaffure.body.own_motion import own_motion
from quaffure.body.surface_morphs import SurfaceMorphs
from quaffure.drape_motion import bodies_of, drape_motion
from quaffure.geometry import posed_surface
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.geometry.signed_distance import signed_distance
from quaffure.hair import AnimatedSkin, CharacterSpace, ExportClip
from quaffure.hair.character_morphs import surface_morphs
from quaffure.hair.groom_binding import groom_binding
from quaffure.hair.placed_clip import placed_clip
from quaffure.io import read_motion as motion_reader
from quaffure.scene import BodyBatch
from tests.characters import character
from tests.test_own_motion import FPS, moving, own_body

SWELLING = 0.02
"""Largest displacement of the head's skin by the target [m]."""
FRAMES = 9


def swelling(moved: Character, body: BodyModel) -> Character:
    """The skin of the head moves outwards, from nothing in the first frame to `SWELLING` in the last; a second target,
    which nothing drives, would move everything."""
    (clip,), (mesh,) = moved.animations, moved.meshes
    normals = angle_weighted_vertex_normals(torch.from_numpy(mesh.bind_vertices)[None], body.faces)[0].numpy()
    head = body.dense_skin_weights[:, body.joint_names.index("Head")].double().numpy()
    swollen = 100 * SWELLING * head[:, None] * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    weights = np.stack([np.linspace(0, 1, FRAMES), np.full(FRAMES, 0.25)], axis=1)
    channel = AnimationChannel(mesh.node, "weights", "LINEAR", clip.channels[0].times, weights[:, None])
    mesh = replace(mesh, morph_targets={"swollen": swollen, "all": 0 * swollen + 5.0}, morph_weights=(0.0, 0.25))
    return replace(moved, meshes=(mesh,), animations=(CharacterAnimation("swells", (*clip.channels, channel)),))


@pytest.fixture(scope="module")
def swollen(body: BodyModel) -> tuple[BodyModel, Character, Motion]:
    rest = character(body)
    own, moved = own_body(rest, body), swelling(moving(rest, FRAMES), body)
    # The second target changes nothing, but is there at rest.
    (mesh,) = moved.meshes
    moved = replace(moved, meshes=(replace(mesh, vertices=mesh.posed(moved.nodes.world)),))
    own = own_body(replace(rest, meshes=moved.meshes), body)
    motion = own_motion(moved, moved.animations[0], own, FPS)
    return own, moved, replace(motion, morphs=surface_morphs(moved, moved.animations[0], own, motion.times))


def file_vertices(of: tuple[BodyModel, Character, Motion], frame: int) -> np.ndarray:
    """The file's own skin in a frame, in the body's space [m]."""
    own, moved, motion = of
    (poses,) = poses_at(moved, moved.animations[0], motion.times[frame : frame + 1])
    (mesh,) = moved.meshes
    assert own.origin is not None
    return own.origin.body_from_file(mesh.posed(poses.world[0], poses.morph_weights[mesh.node][0]))


def bodies(of: tuple[BodyModel, Character, Motion], rows: slice) -> BodyBatch:
    own, _, motion = of
    assert motion.morphs is not None
    pose = motion.body_pose[rows]
    return BodyBatch(own, pose, torch.zeros(len(pose), 10), motion.morphs.offsets(rows))


def test_the_surface_is_where_the_file_has_its_skin(swollen: tuple[BodyModel, Character, Motion]) -> None:
    own, _, motion = swollen
    assert motion.morphs is not None
    assert motion.morphs.directions.shape[0] == 1  # the target that nothing drives is left out
    of_head = own.dense_skin_weights[:, own.joint_names.index("Head")].numpy() > 0.5
    for frame in (0, 5, FRAMES - 1):
        found = bodies(swollen, slice(frame, frame + 1)).posed.vertices[0] + motion.translation[frame]
        apart = np.linalg.norm(found.numpy() - file_vertices(swollen, frame), axis=1)[of_head]
        assert 1e3 * apart.max() < 0.2
    moved = motion.morphs.offsets(slice(FRAMES - 1, FRAMES))[0].norm(dim=1)
    assert float(moved.max()) == pytest.approx(SWELLING, rel=0.02)
    assert not moved[own.dense_skin_weights[:, own.joint_names.index("LeftHand")] > 0.5].any()


def test_the_compiled_view_of_a_morphed_body_is_the_reference_s(swollen: tuple[BodyModel, Character, Motion]) -> None:
    batch, config = bodies(swollen, slice(6, 9)), MlsBodyConfig()
    pose, shape = batch.body_pose, batch.body_shape
    compiled = head_frame_body(batch.body, pose, shape, batch.joints, config, offsets=batch.offsets)
    expected = head_frame_body_reference(batch.body, pose, shape, batch.posed, config)
    without = head_frame_body(batch.body, pose, shape, batch.joints, config)
    torch.testing.assert_close(compiled.world_skin, expected.world_skin, atol=3e-6, rtol=0)
    torch.testing.assert_close(compiled.scalp, expected.scalp, atol=2e-6, rtol=0)
    torch.testing.assert_close(compiled.surface.points, expected.surface.points, atol=2e-6, rtol=0)
    assert float((compiled.scalp - without.scalp).norm(dim=-1).median()) > 0.5 * SWELLING
    torch.testing.assert_close(batch.rows(slice(1, 2)).posed.vertices, batch.posed.vertices[1:2])


@pytest.mark.parametrize("morphs", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_hair_is_outside_of_the_swollen_head(
    morphs: bool, swollen: tuple[BodyModel, Character, Motion], body: BodyModel
) -> None:
    """Long hair over face and neck; in a drape that does not know of the target, it is in the skin."""
    own, moved, motion = swollen
    last = motion.select(slice(FRAMES - 2, FRAMES))
    groom = qf.load_groom("long_wavy", own).thinned(300)
    drawn = last if morphs else replace(last, morphs=None)
    sequence = drape_motion(qf.load_model().draper, groom, own, drawn, torch.zeros(10))
    skin = torch.from_numpy(file_vertices(swollen, FRAMES - 1))[None].float() - motion.translation[-1]
    surface = posed_surface(own.surface_topology, skin)
    hair = torch.from_numpy(sequence.in_place().strands[-1, :, 1:].reshape(1, -1, 3))
    depth = -signed_distance(hair, surface)[0]
    inside = float((depth > 0.001).float().mean())
    if not morphs:
        assert inside > 0.02
        return
    assert inside < 0.002
    of_head = own.dense_skin_weights[:, own.joint_names.index("Head")] > 0.5
    posed = bodies_of(sequence, own).posed.vertices[-1]
    torch.testing.assert_close(posed[of_head], skin[0, of_head], atol=2e-4, rtol=0)
    space = CharacterSpace(
        own.origin, last.start, AnimatedSkin(moved, moved.animations[0], moved.meshes[0], last.times)
    )
    clip = placed_clip(ExportClip(sequence, binding=groom_binding(groom, own, torch.zeros(10))), space)
    assert own.origin is not None
    roots = own.origin.file_from_body(sequence.strands[-1, :, 0])
    moved_by = np.linalg.norm(clip.strands(1)[:, 0] - roots, axis=1) / own.origin.scale
    assert 1e3 * moved_by.max() < 0.2  # they are there already


def test_motions_keep_their_morphs(
    swollen: tuple[BodyModel, Character, Motion], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own, moved, motion = swollen
    assert motion.morphs is not None
    half = motion.frames("2:9:2")
    assert half.morphs is not None
    torch.testing.assert_close(half.morphs.weights, motion.morphs.weights[2::2])
    twice = resample(motion, 2 * FPS)
    assert twice.morphs is not None
    torch.testing.assert_close(twice.morphs.weights[1], motion.morphs.weights[:2].mean(0))
    monkeypatch.setattr(motion_reader, "read_character", lambda path: moved)
    (tmp_path / "a.glb").touch()
    read = motion_reader.read_motion(tmp_path / "a.glb", own)
    assert read.morphs is not None
    torch.testing.assert_close(read.morphs.weights, motion.morphs.weights)
    with pytest.raises(InputError, match="weights of morph targets in 2 frames, found 9"):
        replace(motion.frames("0:2"), morphs=motion.morphs)


def test_what_moves_no_skin_of_the_head_is_left_out(swollen: tuple[BodyModel, Character, Motion]) -> None:
    own, moved, motion = swollen
    (clip,), (mesh,) = moved.animations, moved.meshes
    still = replace(clip, channels=clip.channels[:-1])
    assert surface_morphs(moved, still, own, motion.times) is None
    wig = replace(moved, meshes=(replace(mesh, name="Hair"), replace(mesh, node=mesh.node + 1)))
    assert surface_morphs(wig, clip, own, motion.times) is None
    huge = replace(mesh, morph_targets={name: 100 * target for name, target in mesh.morph_targets.items()})
    with pytest.raises(InputError, match="move skin by at most 1 m"):
        surface_morphs(replace(moved, meshes=(huge,)), clip, own, motion.times)
    with pytest.raises(InputError, match="found nan"):
        SurfaceMorphs(torch.full((1, 2, 3), torch.nan), torch.ones(3, 1)).check("a.glb")


def test_a_bound_on_changes_is_of_each_frame(swollen: tuple[BodyModel, Character, Motion]) -> None:
    """Many targets, one at a time: together they would move the skin by more than a head."""
    step = torch.zeros(60, 4, 3)
    step[:, 0, 0] = SWELLING
    SurfaceMorphs(step, torch.eye(60)).check("a clip")
    for weight in (60.0, float("nan")):
        with pytest.raises(InputError, match="a clip: expected morph targets that move skin by at most 1 m"):
            SurfaceMorphs(step, weight * torch.eye(60)).check("a clip")


def test_offsets_of_other_bodies_are_refused(swollen: tuple[BodyModel, Character, Motion]) -> None:
    batch = bodies(swollen, slice(0, 2))
    assert batch.offsets is not None
    check_offsets(batch.offsets, batch.body, 2)
    for wrong in (batch.offsets[:1], batch.offsets[:, 1:]):
        with pytest.raises(InputError, match=r"offsets: expected \[2, "):
            check_offsets(wrong, batch.body, 2)
