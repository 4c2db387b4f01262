"""Channels between their keys, and the poses of all nodes."""

import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from quaffure import InputError
from quaffure.body import AnimationChannel, Character, CharacterNodes, frame_times, poses_at
from quaffure.body.character_animation import sampled
from quaffure.body.character_clip import _turned, animation_of, bind_pose, character_clip
from quaffure.character.skeleton import rest_clip
from quaffure.input_file import file_and_clip
from quaffure.io.read_character import read_character
from tests.gltf_files import NAMES, GltfFile, figure

TIMES = np.array([1.0, 2.0, 4.0])


def channel(path: str, how: str, values: np.ndarray, times: np.ndarray = TIMES) -> AnimationChannel:
    rows = 3 if how == "CUBICSPLINE" else 1
    return AnimationChannel(0, path, how, times, np.asarray(values, float).reshape(len(times), rows, -1))


def read(file: GltfFile, folder: Path) -> Character:
    (folder / "file.glb").write_bytes(file.glb())
    return read_character(folder / "file.glb")


@pytest.mark.parametrize(
    ("how", "expected"),
    [("STEP", [0, 0, 0, 2, 2, 10, 10]), ("LINEAR", [0, 0, 1, 2, 4, 10, 10])],
)
def test_steps_and_lines(how: str, expected: list[float]) -> None:
    found = sampled(channel("translation", how, [[0, 0, 0], [2, 4, 6], [10, 10, 10]]),
                    np.array([0.0, 1.0, 1.5, 2.0, 2.5, 4.0, 9.0]))  # fmt: skip
    np.testing.assert_allclose(found[:, 0], expected)


def test_cubic_splines_are_hermite_polynomials() -> None:
    """Tangents count per second: on 2 s, half way, p = (p0 + p1) / 2 + 2 (m0 - m1) / 8, by hand."""
    keys = [[0, 1, 3], [-1, 2, 5], [7, 6, 0]]  # arriving tangent, value, leaving tangent
    found = sampled(channel("weights", "CUBICSPLINE", np.array(keys)), np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0]))
    np.testing.assert_allclose(found[:, 0], [1, 1.5 + (3 - -1) / 8, 2, 4 + 2 * (5 - 7) / 8, 6, 6])
    # A cubic polynomial is its own spline.
    cubic = np.polynomial.Polynomial([1.0, -2, 0.5, 0.25])
    keys = np.stack([cubic.deriv()(TIMES), cubic(TIMES), cubic.deriv()(TIMES)], axis=1)
    at = np.linspace(1, 4, 31)
    np.testing.assert_allclose(sampled(channel("weights", "CUBICSPLINE", keys), at)[:, 0], cubic(at), atol=1e-12)


def test_rotations_run_along_the_shorter_arc_at_constant_speed() -> None:
    turns = Rotation.from_rotvec([[0, 0, 0.2], [1, 2, -0.5], [0.3, 0, 0]])
    signs = np.array([[1], [-1], [2.5]])  # the opposite quaternion is the same rotation, at any length
    at = np.linspace(1, 4, 40)
    found = sampled(channel("rotation", "LINEAR", signs * turns.as_quat()), at)
    expected = Slerp(TIMES, turns)(at)
    assert (Rotation.from_quat(found).inv() * expected).magnitude().max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    still = sampled(channel("rotation", "LINEAR", [[0, 0, 0, 1]] * 3), at)
    np.testing.assert_array_equal(still, [[0, 0, 0, 1]] * len(at))


def test_rotations_of_splines_have_length_one() -> None:
    keys = np.array([[[0, 0, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]], [[0, 1, 0, 0], [1, 0, 0, 0], [0] * 4]], float)
    found = sampled(channel("rotation", "CUBICSPLINE", keys, np.array([0.0, 1.0])), np.linspace(0, 1, 9))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    half = np.array([0.5 + 1 / 8, -1 / 8, 0, 0.5])  # means of the values, and an eighth of the tangents' difference
    np.testing.assert_allclose(found[4], half / np.linalg.norm(half))


def test_keys_at_one_time_and_single_keys() -> None:
    twice = channel("translation", "LINEAR", [[0] * 3, [1] * 3, [5] * 3], np.array([0.0, 1.0, 1.0]))
    np.testing.assert_allclose(sampled(twice, np.array([0.5, 1.0, 2.0]))[:, 0], [0.5, 5, 5])
    one = channel("scale", "CUBICSPLINE", [[9, 2, 9]], np.array([3.0]))
    np.testing.assert_allclose(sampled(one, np.array([0.0, 3.0, 4.0]))[:, 0], 2)


def test_poses_of_all_nodes(tmp_path: Path) -> None:
    """Scale and translation of the nodes above reach those below; what no channel moves stays at rest."""
    file = GltfFile()
    file.document["nodes"] = [
        {"name": "a", "children": [1]}, {"name": "b", "translation": [1, 0, 0], "children": [2]},
        {"name": "c", "translation": [0, 1, 0]},
    ]  # fmt: skip
    quarter = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    file.animation("x", [
        (0, "scale", "LINEAR", [0, 1], [[1, 1, 1], [3, 3, 3]]), (1, "rotation", "STEP", [0.5], [quarter]),
        (0, "translation", "LINEAR", [0, 1], [[0, 0, 0], [0, 0, 4]]),
    ])  # fmt: skip
    found = read(file, tmp_path)
    (poses,) = poses_at(found, found.animations[0], np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(poses.world[:, 2, :3, 3], [[0, 0, 0], [0, 0, 2], [0, 0, 4]], atol=1e-6)
    np.testing.assert_allclose(poses.world[:, 1, :3, 3], [[1, 0, 0], [2, 0, 2], [3, 0, 4]], atol=1e-6)
    (rest,) = poses_at(found, None, np.zeros(1))
    np.testing.assert_allclose(rest.world[0], found.nodes.world)


def test_weights_of_morph_targets(tmp_path: Path) -> None:
    file = GltfFile()
    positions, delta = file.accessor(np.float32(np.eye(3))), file.accessor(np.float32([[0, 0, 1]] * 3))
    primitive = {"attributes": {"POSITION": positions}, "targets": [{"POSITION": delta}, {}]}
    file.add("meshes", primitives=[primitive])
    file.add("nodes", mesh=0)
    file.animation("smile", [(0, "weights", "LINEAR", [0, 2], np.array([[0, 1], [4, 1]]).reshape(-1, 1))])
    found = read(file, tmp_path)
    (poses,) = poses_at(found, found.animations[0], np.array([1.0]))
    np.testing.assert_allclose(poses.morph_weights[0], [[2, 1]])
    moved = found.meshes[0].posed(poses.world[0], poses.morph_weights[0][0])
    np.testing.assert_allclose(moved, np.eye(3) + np.array([0, 0, 2]))


def test_frames_from_the_first_key_to_the_last(tmp_path: Path) -> None:
    file = GltfFile()
    file.add("nodes")
    file.animation("a", [(0, "scale", "STEP", [0.5, 1.5], np.ones((2, 3))),
                         (0, "rotation", "LINEAR", [1.0, 2.5], [[0, 0, 0, 1]] * 2)])  # fmt: skip
    file.animation("a", [(0, "scale", "STEP", [0.0, 9e5], np.ones((2, 3)))])
    file.animation("lamp", [])
    first, second = read(file, tmp_path).animations
    assert (first.name, second.name, first.span) == ("a", "a#2", (0.5, 2.5))
    np.testing.assert_allclose(frame_times(first, 2.0, 100), [0.5, 1.0, 1.5, 2.0, 2.5])
    with pytest.raises(InputError, match=r"animation 'a#2': expected at most 1000 frames at 30 fps, found 27000000"):
        frame_times(second, 30.0, 1000)


def test_clips_by_name(tmp_path: Path) -> None:
    file = GltfFile()
    file.add("nodes")
    for name in ("walk", "Armature|run", "1"):
        file.animation(name, [(0, "scale", "STEP", [0], np.ones((1, 3)))])
    found = read(file, tmp_path)
    names = [animation_of(found, name).name for name in ("walk", "Armature|run", "#"[1:] + "0", "1")]
    assert names == ["walk", "Armature|run", "walk", "1"]
    with pytest.raises(InputError, match=r"#0 walk, #1 Armature\|run, #2 1, found 3 without a choice"):
        animation_of(found)
    with pytest.raises(InputError, match="found 'fly'"):
        animation_of(found, "fly")
    file.document["animations"] = file.document["animations"][:1]
    assert animation_of(read(file, tmp_path)).name == "walk"
    file.document["animations"] = []
    with pytest.raises(InputError, match="an animation, found none"):
        animation_of(read(file, tmp_path))
    assert file_and_clip("a/b.GLB#x y#2") == (Path("a/b.GLB"), "x y#2")
    assert file_and_clip("b.fbx#Armature|x") == (Path("b.fbx"), "Armature|x")
    assert file_and_clip("b.gltf") == (Path("b.gltf"), "")
    assert file_and_clip("b#2.bvh") == (Path("b#2.bvh"), "")
    (tmp_path / "a.glb#1").touch()
    assert file_and_clip(tmp_path / "a.glb#1") == (tmp_path / "a.glb#1", "")


def test_the_pose_in_which_a_mesh_was_bound(tmp_path: Path) -> None:
    """Nodes may stand in a frame of an animation: inverse bind matrices still hold the T pose."""
    file = figure()
    bound = read(file, tmp_path).nodes.world
    np.testing.assert_array_equal(bind_pose(read(file, tmp_path)), bound)
    for joint, name in enumerate(NAMES):
        if name in ("Spine1", "LeftArm", "Head"):
            file.document["nodes"][joint + 1]["rotation"] = [0.1, 0.7, 0.1, 0.7]
    found = read(file, tmp_path)
    assert np.abs(found.nodes.world - bound).max() > 0.1
    np.testing.assert_allclose(bind_pose(found), bound, atol=1e-5)


def test_a_clip_keeps_no_matrices_of_all_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = 1500
    angles = np.linspace(0, 1, frames * len(NAMES))[:, None] * np.array([0.5, 0.3, 0.1])
    turned = Rotation.from_rotvec(angles).as_matrix().reshape(frames, len(NAMES), 3, 3)
    found = read(figure(turned), tmp_path)
    expected = character_clip(found, found.animations[0], 30.0)
    monkeypatch.setattr("quaffure.body.character_animation.NODES_AT_ONCE", 1000)
    tracemalloc.start()
    clip = character_clip(found, found.animations[0], 30.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(clip.values, expected.values, atol=1e-9)
    assert peak < 200 * frames * len(found.nodes)


def test_the_time_of_a_rest_pose_is_linear_in_its_joints() -> None:
    count = 30_000
    above = np.arange(count) - 1
    still = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    nodes = CharacterNodes(
        tuple(map(str, range(count))), above, np.tile([0.0, 1.0, 0.0], (count, 1)), still, np.ones((count, 3))
    )
    character = Character(nodes, (), (), "file")
    np.testing.assert_array_equal(nodes.world[:, 1, 3], np.arange(count) + 1)
    start = time.process_time()
    clip = rest_clip(character)
    assert time.process_time() - start < 2
    np.testing.assert_array_equal(clip.parents, np.arange(count + 1) - 1)
    np.testing.assert_array_equal(clip.offsets[1:], np.tile([0, 1, 0], (count, 1)))


def test_joints_that_are_sheared_flat_do_not_turn() -> None:
    """The determinant of such a matrix is a rounding, above 0 or below."""
    long, rest = np.array([1.0, 1.0, 1e-5]), np.eye(3)[None]
    turns = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(50, 3))).as_matrix()
    sheared = 1e5 * (turns * long**3) @ turns.mT
    np.testing.assert_array_equal(_turned(sheared[:, None], rest), np.tile(np.eye(3), (50, 1, 1, 1)))
    turned = _turned((turns * [3, 3, 3])[:, None], rest)
    np.testing.assert_allclose(turned[:, 0], turns, atol=1e-12)
