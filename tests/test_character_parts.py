"""Which meshes and which joints of a file a character is made of: teeth, what is worn, and two figures."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from quaffure import InputError
from quaffure.body import BodyModel, Character
from quaffure.character import fit_skeleton, parts_of
from quaffure.character.parts import choose_parts
from tests.characters import character, mesh_of, nodes_at, with_mesh


def test_teeth_of_any_depth_are_in_the_head(body: BodyModel) -> None:
    """Upper teeth with a palate are 10 cm deep; what is worn is not in the head."""
    of = character(body)
    mesh, node = of.meshes[0], of.nodes.names.index("mixamorig:Head")
    scalp = mesh.vertices[np.unique(body.faces[body.scalp.faces].numpy())]
    for name, place in (("Teeth", -3.0), ("Ball", 30.0)):
        box = scalp.mean(0) + [0.0, place, 0.0] + [6.5, 4.6, 10.2] * (np.random.default_rng(3).random((20, 3)) - 0.5)
        joints, weights = np.full((20, 1), node), torch.ones(20, 1)
        of = with_mesh(of, mesh_of(name, box, np.arange(18).reshape(-1, 3), of.nodes, joints, weights))
    chosen = choose_parts(parts_of(of, fit_skeleton(of, body)), body.joint_names, "", ("ball",))
    groups = chosen.skin, chosen.inner, chosen.worn
    assert [[part.mesh for part in group] for group in groups] == [["Body"], ["Teeth"], ["Ball"]]


def test_a_scalp_of_its_own_material_is_skin(body: BodyModel) -> None:
    """It left a hole in the head; a part that touches nothing of the skin is another thing."""
    of = character(body)
    (mesh,) = of.meshes
    on_scalp = np.isin(np.arange(len(mesh.faces)), body.scalp.faces.numpy())
    aside = mesh.vertices[mesh.faces[on_scalp][:40]].reshape(-1, 3) + np.array([0.0, 20.0, 0.0])
    count = len(mesh.vertices)
    painted = replace(
        mesh,
        materials=("Skin", "Crown", "Feather"),
        vertices=np.concatenate([mesh.vertices, aside]),
        bind_vertices=np.concatenate([mesh.bind_vertices, aside]),
        faces=np.concatenate([mesh.faces, count + np.arange(len(aside)).reshape(-1, 3)]),
        face_materials=np.concatenate([on_scalp.astype(int), np.full(40, 2)]),
        skin_joints=np.concatenate([mesh.skin_joints, mesh.skin_joints[:120]]),
        weights=np.concatenate([mesh.weights, mesh.weights[:120]]),
    )
    two = replace(of, meshes=(painted,))
    chosen = choose_parts(parts_of(two, fit_skeleton(two, body)), body.joint_names, "")
    assert [part.material for part in chosen.skin] == ["Skin", "Crown"]


def test_two_figures_are_refused_whatever_their_joints_are_called(body: BodyModel) -> None:
    """Readers tell equal names apart by numbers; the copy of a skeleton that a mesh has for itself is no figure."""
    of = character(body)
    beside, copy = (twice(of, aside) for aside in (80.0, 0.0))
    expected = r"character.glb: expected a file of one figure, or --joints .*, found 2 heads: .*:Head and .*:Head#2 for"
    with pytest.raises(InputError, match=expected):
        fit_skeleton(beside, body)
    one = fit_skeleton(of, body)
    for other in (fit_skeleton(beside, body, one.joint_map), fit_skeleton(copy, body)):
        np.testing.assert_allclose(other.rest_joints, one.rest_joints, atol=1e-9)


def twice(of: Character, aside: float) -> Character:
    """The figure and another one of the same joints."""
    nodes, (mesh,) = of.nodes, of.meshes
    count, places = len(nodes), nodes.world[:, :3, 3]
    names = [*nodes.names, *(f"{name}#2" for name in nodes.names)]
    parents = np.concatenate([nodes.parents, np.where(nodes.parents < 0, -1, nodes.parents + count)])
    turns = np.random.default_rng(1).normal(size=(2 * count, 4))
    shift = np.array([aside, 0.0, 0.0])
    both = nodes_at(names, parents, np.concatenate([places, places + shift]), turns)
    meshes = (
        mesh_of(mesh.name, mesh.vertices, mesh.faces, both, mesh.joints, torch.from_numpy(mesh.weights)),
        mesh_of("Twin", mesh.vertices + shift, mesh.faces, both, mesh.joints + count, torch.from_numpy(mesh.weights)),
    )
    return Character(both, meshes, (), of.source)
