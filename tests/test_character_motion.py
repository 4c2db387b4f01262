"""Animations of characters as motion of the body."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import quaffure as qf
from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel, Motion
from quaffure.io import check_output
from quaffure.io.read_motion import read_motion
from tests.gltf_files import NAMES, PARENTS, GltfFile, figure

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From the body's axes to those of glTF."""
TWISTED = ("ForeArm", "Hand", "HandMiddle1")
"""Joints whose twist is that of another rest pose after retargeting; their bones point where they should."""
OWN_NAMES = {"Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Neck1"}


def own_joint(name: str) -> str:
    return OWN_NAMES.get(name, name.replace("HandMiddle1", "FingerBase"))


def world_rotations(motion: Motion, body: BodyModel) -> np.ndarray:
    rotations, _ = body.posed_joints(motion.body_pose, torch.zeros(len(motion), 10))
    return rotations.double().numpy()


def written(motion: Motion, body: BodyModel, fps: float = 30.0) -> GltfFile:
    """The body's skeleton under Mixamo's names, in centimetres and y up, in a motion of the body."""
    joints = [body.joint_names.index(own_joint(name)) for name in NAMES]
    world = world_rotations(motion, body)[:, joints]
    local = np.where(PARENTS[:, None, None] < 0, world, world[:, PARENTS].mT @ world)
    places = 100 * body.rest_joints.double().numpy()[joints] @ Y_UP.T
    path = None
    if motion.translation is not None:
        path = places[0] + 100 * motion.translation.double().numpy() @ Y_UP.T
    return figure(Y_UP @ local @ Y_UP.T, path, fps, places=places)


def read(file: GltfFile, folder: Path, body: BodyModel, clip: str = "") -> Motion:
    (folder / "file.glb").write_bytes(file.glb())
    return read_motion(folder / f"file.glb{clip}", body)


@pytest.mark.parametrize("name", ["walk", "bow"])
def test_a_motion_that_is_written_is_read_back(name: str, body: BodyModel, tmp_path: Path) -> None:
    motion = qf.load_motion(name).frames("0:60")
    found = read(written(motion, body), tmp_path, body)
    assert (len(found), found.fps, found.name) == (60, 30.0, "file")
    difference = world_rotations(motion, body).swapaxes(2, 3) @ world_rotations(found, body)
    degrees = np.degrees(Rotation.from_matrix(difference.reshape(-1, 3, 3)).magnitude()).reshape(60, 27)
    known = [body.joint_names.index(own_joint(name)) for name in NAMES if not name.endswith(TWISTED)]
    assert degrees[:, known].max() < 1.0
    places = [body.posed_joints(some.body_pose, torch.zeros(60, 10))[1] for some in (motion, found)]
    assert (places[0] - places[1]).norm(dim=-1).max() < 2e-3
    assert found.translation is not None
    expected = np.zeros((60, 3)) if motion.translation is None else motion.translation.numpy()
    np.testing.assert_allclose(found.translation.numpy(), expected, atol=2e-3)


def test_the_rate_of_keys_does_not_matter(body: BodyModel, tmp_path: Path) -> None:
    motion = qf.load_motion("nod").frames("0:60")
    found = read(written(motion, body, fps=60.0), tmp_path, body)
    assert (len(found), found.fps) == (30, 30.0)
    again = world_rotations(motion, body)[::2].swapaxes(2, 3) @ world_rotations(found, body)
    assert np.degrees(Rotation.from_matrix(again[:, 16]).magnitude()).max() < 0.1


def test_a_t_pose_in_the_first_frames_is_kept(body: BodyModel, tmp_path: Path) -> None:
    """Frames of a character line up with its file: nothing is dropped."""
    turned = np.tile(np.eye(3), (40, len(NAMES), 1, 1))
    turned[20:, NAMES.index("Head")] = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    found = read(figure(turned), tmp_path, body)
    head = world_rotations(found, body)[:, body.joint_names.index("Head")]
    turns = np.degrees(Rotation.from_matrix(head).as_rotvec()[:, 2])
    np.testing.assert_allclose(turns[[0, 19, 20, 39]], [0, 0, 30, 30], atol=1e-3)


def test_nodes_in_another_pose_than_the_mesh(body: BodyModel, tmp_path: Path) -> None:
    """The T pose in which the mesh was bound is the rest pose, whatever the nodes' own transforms are."""
    turned = np.tile(np.eye(3), (5, len(NAMES), 1, 1))
    turned[:, NAMES.index("Head")] = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    plain = figure(turned)
    expected = read(plain, tmp_path, body)
    for name in ("Spine", "Head", "LeftArm"):
        plain.document["nodes"][NAMES.index(name) + 1]["rotation"] = [0.5, -0.5, 0.5, 0.5]
    found = read(plain, tmp_path, body)
    np.testing.assert_allclose(found.body_pose, expected.body_pose, atol=1e-5)


def test_clips_are_chosen_by_name(body: BodyModel, tmp_path: Path) -> None:
    turned = np.tile(np.eye(3), (3, len(NAMES), 1, 1))
    file = figure(turned)
    file.document["animations"].append({**file.document["animations"][0], "name": "Armature|run / fast"})
    assert read(file, tmp_path, body, "#1").name == "file_Armature_run_fast"
    assert read(file, tmp_path, body, "#moves").name == "file_moves"
    assert len(qf.load_motion(f"{tmp_path}/file.glb#Armature|run / fast")) == 3
    with pytest.raises(InputError, match=r"#0 moves, #1 Armature\|run / fast, found 2 without a choice"):
        read(file, tmp_path, body)
    with pytest.raises(InputError, match="an animation, found none"):
        read(figure(), tmp_path, body)


def test_a_character_is_not_replaced_by_its_hair(tmp_path: Path) -> None:
    path = tmp_path / "file.glb"
    path.write_bytes(figure(np.tile(np.eye(3), (3, len(NAMES), 1, 1))).glb())
    with pytest.raises(InputError, match="an output that is none of the inputs"):
        check_output(path, ".glb", inputs=(f"{path}#moves",))


def test_joint_maps(body: BodyModel, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    turned = np.tile(np.eye(3), (3, len(NAMES), 1, 1))
    path = tmp_path / "file.glb"
    path.write_bytes(figure(turned).glb())
    main(["inspect", str(path), "--save-joints", str(tmp_path / "map.toml")])
    assert 'LeftArm = "mixamorig:LeftArm"' in (tmp_path / "map.toml").read_text()
    other = figure(turned)
    for index, node in enumerate(other.document["nodes"]):
        node["name"] = f"bone{index}"
    path.write_bytes(other.glb())
    with pytest.raises(InputError, match="joints whose names are known"):
        read_motion(path, body)
    table = (tmp_path / "map.toml").read_text()
    for index, name in enumerate(NAMES, 1):
        table = table.replace(f'"mixamorig:{name}"', f'"bone{index}"')
    (tmp_path / "map.toml").write_text(table)
    assert len(read_motion(path, body, tmp_path / "map.toml")) == 3
    np.savez(tmp_path / "m.npz", body_pose=np.zeros((2, 81)), fps=30.0)
    with pytest.raises(InputError, match=r"a joint map for a file of \.bvh, \.glb, \.gltf"):
        read_motion(tmp_path / "m.npz", body, tmp_path / "map.toml")


def test_inspect_says_what_a_character_holds(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "file.glb"
    path.write_bytes(figure(np.tile(np.eye(3), (31, len(NAMES), 1, 1)), np.zeros((31, 3))).glb())
    main(["inspect", str(path), "--json"])
    found = json.loads(capfd.readouterr().out)
    assert (found["kind"], found["nodes"], found["joints"]) == ("character", 26, 25)
    assert found["meshes"]["Body"] == "96 vertices, 96 triangles, 24 joints, materials Skin"
    assert found["animations"]["moves"] == "0 s to 1 s, 31 keys at 30 per second, moves 24 nodes"
    assert found["extent_units"][1][1] == pytest.approx(1.56, abs=0.01)
    assert found["joint_map"]["Neck"] == ["mixamorig:Spine2", "mixamorig:Neck"]
    assert "refused" not in found
    path.write_bytes(figure().glb())
    main(["inspect", str(path)])
    said = capfd.readouterr().out
    assert "animations: none" in said
    assert "can be used as" not in said.split("animations")[0]
