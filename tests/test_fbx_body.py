"""FBX files wherever characters are taken: bodies, their own animations, the scene of the file, other motion."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure.apps.cli.main import main
from quaffure.body import BodyModel, Character
from quaffure.body.own_motion import is_own, own_motion
from quaffure.character import ImportSettings
from quaffure.character.import_body import import_body
from quaffure.io.character_scene import read_character_space
from quaffure.io.read_character import read_character
from quaffure.io.read_motion import read_motion
from tests.characters import REFERENCE_GRID, character
from tests.fbx_characters import FbxForm, fbx_of
from tests.gltf_files import NAMES, figure
from tests.test_own_motion import FPS, moving, own_body

FORM = FbxForm(is_z_up=True, is_turned=True)


@pytest.fixture(scope="module")
def rest(body: BodyModel) -> Character:
    return character(body, centimetres=False)


@pytest.fixture(scope="module")
def path(rest: Character, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The body of the package on a Mixamo rig, moving, in centimetres and z up."""
    path = tmp_path_factory.mktemp("fbx") / "dancer.FBX"
    path.write_bytes(fbx_of(moving(rest), FORM).content(7500, is_deflated=True))
    return path


@pytest.fixture(scope="module")
def own(rest: Character, body: BodyModel) -> BodyModel:
    return own_body(rest, body)


@pytest.mark.slow
def test_the_body_of_a_file_is_that_of_its_character(rest: Character, path: Path, body: BodyModel) -> None:
    pytest.importorskip("igl")
    settings = ImportSettings(cell=2 * REFERENCE_GRID)
    found, expected = (import_body(each, "0" * 64, body, settings) for each in (read_character(path), rest))
    assert found.notes[:2] == expected.notes[:2]  # the others name the mesh
    assert found.body.origin is not None
    assert expected.body.origin is not None
    assert found.body.origin.joint_nodes == expected.body.origin.joint_nodes
    assert found.body.origin.scale == 1
    torch.testing.assert_close(found.body.rest_joints, expected.body.rest_joints, atol=1e-5, rtol=0)
    torch.testing.assert_close(found.body.rest_vertices, expected.body.rest_vertices, atol=1e-4, rtol=0)
    torch.testing.assert_close(found.body.scalp.uv, expected.body.scalp.uv, atol=1e-4, rtol=0)


def test_a_body_takes_the_animation_of_its_file(rest: Character, path: Path, own: BodyModel) -> None:
    moved = moving(rest)
    assert is_own(own, read_character(path))
    found = read_motion(Path(f"{path}#moves"), own)
    expected = own_motion(moved, moved.animations[0], own, FPS)
    assert (found.name, found.start) == ("dancer", pytest.approx(0.5))
    torch.testing.assert_close(found.body_pose, expected.body_pose, atol=1e-4, rtol=0)
    assert found.translation is not None
    torch.testing.assert_close(found.translation, expected.translation, atol=1e-4, rtol=0)


def test_the_scene_of_a_file_has_its_skin(rest: Character, path: Path, own: BodyModel) -> None:
    times = 0.5 + np.arange(9) / FPS
    found = read_character_space(own, f"{path}#0", times)
    assert found is not None
    assert found.skin is not None
    np.testing.assert_allclose(found.skin.vertices(0), rest.meshes[0].vertices, atol=1e-5)
    assert np.abs(found.skin.vertices(8) - found.skin.vertices(0)).max() > 1
    roots = own.rest_vertices[own.faces[own.scalp.faces].unique()[::90]].double().numpy()
    bound = found.bound(roots)
    assert bound is not None
    placed = found.placed(roots, np.ones(len(roots), int), bound, 0)
    np.testing.assert_allclose(placed, found.origin.file_from_body(roots), atol=1e-5)


def test_motion_and_maps_of_joints(tmp_path: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]) -> None:
    turned = np.tile(np.eye(3), (31, len(NAMES), 1, 1))
    (tmp_path / "file.glb").write_bytes(figure(turned, np.full((31, 3), 90.0)).glb())
    (tmp_path / "file.fbx").write_bytes(fbx_of(read_character(tmp_path / "file.glb"), FORM).content())
    found, expected = (read_motion(tmp_path / f"file{suffix}", body) for suffix in (".fbx", ".glb"))
    torch.testing.assert_close(found.body_pose, expected.body_pose, atol=1e-4, rtol=0)
    main(["inspect", str(tmp_path / "file.fbx"), "--json", "--save-joints", str(tmp_path / "map.toml")])
    said = json.loads(capfd.readouterr().out)
    assert (said["kind"], said["nodes"], said["joints"]) == ("character", 27, 26)
    assert said["meshes"]["Body"] == "96 vertices, 96 triangles, 24 joints, materials Skin"
    assert said["animations"]["moves"] == "0 s to 1 s, 31 keys at 30 per second, moves 24 nodes"
    assert 'LeftArm = "mixamorig:LeftArm"' in (tmp_path / "map.toml").read_text()
    named = read_motion(tmp_path / "file.fbx", body, tmp_path / "map.toml")
    torch.testing.assert_close(named.body_pose, expected.body_pose, atol=1e-4, rtol=0)
