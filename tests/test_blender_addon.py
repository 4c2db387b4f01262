"""The parts of the Blender add-on that need no Blender; scripts/check_blender_addon.py runs the whole of it."""

import ast
import importlib.util
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from zipfile import ZipFile

import numpy as np
import pytest
import torch

from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from scripts.build_blender_addon import SOURCE, build


@pytest.fixture(scope="module")
def process() -> ModuleType:
    spec = importlib.util.spec_from_file_location("quaffure_process", SOURCE / "process.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_zip_is_an_extension(tmp_path: Path) -> None:
    build(tmp_path / "addon.zip")
    with ZipFile(tmp_path / "addon.zip") as archive:
        assert {"__init__.py", "blender_manifest.toml", "operators.py"} <= {*archive.namelist()}
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        for name in archive.namelist():
            if name.endswith(".py"):
                ast.parse(archive.read(name))
    assert (manifest["type"], manifest["license"]) == ("add-on", ["SPDX:Apache-2.0"])
    assert not manifest["tagline"].endswith(".")  # Blender refuses it


def test_joints_are_those_of_the_body(body: BodyModel) -> None:
    tree = ast.parse((SOURCE / "character.py").read_text(encoding="utf-8"))
    (parents,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "DEFAULT_PARENTS"
    )
    names = body.joint_names
    assert parents == {name: names[parent] if parent >= 0 else "" for name, parent in zip(names, body.joint_parents)}
    assert tuple(parents) == names


def test_an_absent_quaffure_is_one_clear_line(process: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(process.QuaffureError, match=r"expected a Python with quaffure .* found '.*no python'"):
        process.run(str(tmp_path / "no python"), ["info"])
    other = tmp_path / "python"
    other.write_text(f'#!/bin/sh\nexec {sys.executable} -I -S "$@"\n')
    other.chmod(0o755)
    with pytest.raises(process.QuaffureError, match="found one without it"):
        process.run(str(other), ["info"])


def test_progress_and_errors_are_read(process: ModuleType, tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho '8 of 60, 0:00:10 left: draping'\necho 'quaffure: no groom' >&2\nexit 2\n")
    python.chmod(0o755)
    run = process.Run(str(python), ["drape"])
    with pytest.raises(process.QuaffureError, match="quaffure: no groom"):
        run.finish()
    assert [*run.progress()] == [(8, 60)]


def test_a_rig_poses_as_the_body_does(tmp_path: Path, tiny_groom_file: Path, body: BodyModel) -> None:
    main(["rig", str(tiny_groom_file), "--shape=1,0,0,0,0,0,0,0,0,0", "--out", str(tmp_path / "rig.npz")])
    with np.load(tmp_path / "rig.npz", allow_pickle=False) as file:
        rig = {name: file[name] for name in file.files}
    pose, shape = torch.zeros(1, 81), torch.zeros(1, 10)
    shape[0, 0], pose[0, 3 * list(body.joint_names).index("Head") + 2] = 1.0, 0.5
    expected = body.pose(pose, shape)
    rotations, positions = expected.joint_rotations[0].numpy(), expected.joint_positions[0].numpy()
    own = np.zeros_like(rig["body_vertices"])
    for slot in range(rig["skin_joints"].shape[1]):
        joint, weight = rig["skin_joints"][:, slot], rig["skin_weights"][:, slot, None]
        moved = np.einsum("vij,vj->vi", rotations[joint], rig["body_vertices"] - rig["rest_joints"][joint])
        own += weight * (moved + positions[joint])
    np.testing.assert_allclose(own, expected.vertices[0].numpy(), atol=1e-5)
    assert rig["strands"].shape[1:] == (24, 3)
