"""`quaffure body import` with its options, on a file that is written here."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

import quaffure as qf
from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.apps.render import StrandRenderer
from quaffure.body import BodyModel, Character
from quaffure.character import Triangles, import_body
from quaffure.character.collision_surface import _pieces, _welded
from tests.characters import MIXAMO, character, mesh_of
from tests.fbx_characters import fbx_of

pytest.importorskip("igl")
NAMES = {f"B{index:02}": joint for index, joint in enumerate(MIXAMO.values())}
"""Joints whose names say nothing."""
CORNERS = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), -1).reshape(-1, 3)
Z_UP = [0, 2, 1], [1.0, -1.0, 1.0]


@pytest.fixture(scope="module")
def rest(body: BodyModel) -> Character:
    """Its scalp is a material, and a box is in front of its chest."""
    of = character(body, NAMES, "", centimetres=False)
    (mesh,) = of.meshes
    on_scalp = np.isin(np.arange(len(mesh.faces)), body.scalp.faces.numpy())
    skin = replace(mesh, materials=("Skin", "Crown"), face_materials=on_scalp.astype(int))
    chest = of.nodes.world[of.nodes.names.index("B03"), :3, 3]
    box = chest + [0.0, 0.0, 0.4] + 0.04 * CORNERS
    faces = ConvexHull(CORNERS).simplices
    first, second, third = CORNERS[faces].transpose(1, 0, 2)
    inwards = (np.cross(second - first, third - first) * first).sum(1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    joints, weights = np.full((8, 1), of.nodes.names.index("B03")), torch.ones(8, 1)
    amulet = mesh_of("Amulet", box, faces, of.nodes, joints, weights)
    count, nodes = len(of.nodes), of.nodes
    both = replace(
        nodes,
        names=(*nodes.names, "Body", "Amulet"),
        parents=np.concatenate([nodes.parents, [-1, -1]]),
        translation=np.concatenate([nodes.translation, np.zeros((2, 3))]),
        rotation=np.concatenate([nodes.rotation, [[0.0, 0.0, 0.0, 1.0]] * 2]),
        scale=np.concatenate([nodes.scale, np.ones((2, 3))]),
    )
    return replace(of, nodes=both, meshes=(replace(skin, node=count), replace(amulet, node=count + 1)))


@pytest.fixture
def file(rest: Character, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The character, its joint map and a groom on its scalp, z up; its surface is its mesh, whose holes are filled."""

    def of_the_mesh(skin: Triangles, head: np.ndarray, cell: float) -> Triangles:
        return _pieces(_welded(skin))

    monkeypatch.setattr(import_body, "closed_surface", of_the_mesh)
    (tmp_path / "file.fbx").write_bytes(fbx_of(rest).content())
    lines = [f'{joint} = "{name}"' for name, joint in NAMES.items()]
    (tmp_path / "map.toml").write_text("\n".join(lines))
    skin = rest.meshes[0]
    roots = skin.vertices[np.unique(skin.faces[skin.face_materials == 1])]
    strands = roots[:, None] + np.linspace(0, 0.1, 5)[:, None] * [0.0, 1.0, 0.0]
    np.save(tmp_path / "strands.npy", (strands[..., Z_UP[0]] * Z_UP[1]).astype(np.float32))
    return tmp_path / "file.fbx"


def scalp_of(body: BodyModel) -> torch.Tensor:
    return body.rest_vertices[body.faces[body.scalp.faces]].mean(1)


def imported(file: Path, *options: str) -> BodyModel:
    out = file.with_name("body.npz")
    main(["body", "import", str(file), "--joints", str(file.with_name("map.toml")), "--out", str(out), *options])
    return qf.load_body(out)


@pytest.mark.slow
def test_an_import_with_all_options(file: Path, body: BodyModel, capfd: pytest.CaptureFixture[str]) -> None:
    picture = ["--picture", str(file.with_name("body.png"))]
    try:
        StrandRenderer(8, 8).release()
    except InputError:
        picture = []
    worn = imported(file, "--scalp", "crown", "--collide", "amulet", *picture)
    said = capfd.readouterr().out
    for words in (
        'Head = "B05"',
        "skin: Body (Skin), Body (Crown)",
        "hair collides with: Amulet (AmuletMaterial)",
        "scalp: crown",
    ):
        assert words in said
    assert file.with_name("body.png").exists() == bool(picture)
    by_roots = imported(file, "--groom", str(file.with_name("strands.npy")))
    assert "strands.npy, read with z up where the character has y up" in capfd.readouterr().out
    for found in (worn, by_roots):
        for there, back in ((scalp_of(body), scalp_of(found)), (scalp_of(found), scalp_of(body))):
            assert float(torch.cdist(there, back).amin(1).quantile(0.9)) < 0.02
    front, behind = (float(found.rest_vertices[:, 1].min()) for found in (worn, by_roots))
    assert front < behind - 0.03
