"""A character becomes a body: joints, surface, scalp; grooms and drapes on it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import quaffure as qf
from quaffure import InputError
from quaffure.backend import Backend
from quaffure.benchmark import intersection_percent
from quaffure.body import BodyModel, Character, automatic_joint_map
from quaffure.body.hair_names import is_hair_name
from quaffure.body.joint_map import JointSource
from quaffure.character import ImportSettings, Triangles, fit_skeleton, parts_of
from quaffure.character.collision_surface import closed_surface
from quaffure.character.import_body import ImportedBody, import_body
from quaffure.character.skeleton import rest_clip
from quaffure.geometry.hole_filling import boundary_loops
from quaffure.hair import distances_and_normals
from quaffure.io.body_file import write_body
from quaffure.model import NeuralDraper
from quaffure.scene import BodyBatch, Scene
from tests.characters import MIXAMO, REFERENCE_GRID, character, mesh_of, nodes_at, with_mesh

pytest.importorskip("igl")
WIDE_HEAD = (1.3, 1.2, 1.25)
NARROW_HEAD = (0.72, 0.95, 1.15)
COARSE = ImportSettings(cell=REFERENCE_GRID)


@pytest.fixture(scope="module", autouse=True)
def _each_surface_is_closed_once() -> Iterator[None]:
    """A collision surface takes seconds, and many characters here have the same skin."""
    found: dict[tuple[bytes, bytes, bytes, float], Triangles] = {}

    def once(skin: Triangles, head: np.ndarray, cell: float) -> Triangles:
        key = (skin.vertices.tobytes(), skin.faces.tobytes(), head.tobytes(), cell)
        found[key] = found.get(key) or closed_surface(skin, head, cell)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("quaffure.character.import_body.closed_surface", once)
        yield


@pytest.fixture(scope="module")
def twin(body: BodyModel) -> ImportedBody:
    """The body of the package, exported in a T pose on a Mixamo rig in centimetres, and imported."""
    return import_body(character(body), "0" * 64, body, COARSE)


def joint_distance_mm(first: BodyModel, second: BodyModel, names: tuple[str, ...]) -> float:
    rows = [first.joint_names.index(name) for name in names]
    return float(1e3 * (first.rest_joints[rows] - second.rest_joints[rows]).norm(dim=1).max())


def test_joints_of_the_file_come_back_in_our_rest_pose(body: BodyModel) -> None:
    fitted = fit_skeleton(character(body), body)
    apart = 1e3 * np.linalg.norm(fitted.rest_joints - body.rest_joints.numpy(), axis=1)
    assert fitted.metres == 0.01
    assert apart.max() < 2.0  # the Neck, which the rig lacks, is placed
    assert [name for name, node in zip(body.joint_names, fitted.joint_nodes) if not node] == [
        "LHipJoint", "Neck", "RHipJoint",
    ]  # fmt: skip


def test_unit_and_ground_are_those_of_the_figure(body: BodyModel) -> None:
    """A pole that a hand holds does not count, and a figure of 70 inches is not one of 70 cm."""
    of = character(body)
    node = of.nodes.names.index("mixamorig:RightHand")
    pole = np.array([[40.0, -100.0, 0.0], [41.0, -100.0, 0.0], [40.0, 200.0, 0.0]])
    joints, weights = np.full((3, 1), node), torch.ones(3, 1)
    prop = replace(mesh_of("Pole", pole, np.array([[0, 1, 2]]), of.nodes, joints, weights), is_rigid=True)
    alone, held = fit_skeleton(of, body), fit_skeleton(with_mesh(of, prop), body)
    assert held.metres == alone.metres
    np.testing.assert_array_equal(held.rest_joints, alone.rest_joints)
    assert fit_skeleton(scaled(of, 1 / 2.54), body).metres == 0.0254
    assert fit_skeleton(scaled(of, 0.005), body).metres == 1.0  # half as tall, in metres


def scaled(of: Character, factor: float) -> Character:
    """The same in another unit."""
    nodes = replace(of.nodes, translation=factor * of.nodes.translation)
    return replace(of, nodes=nodes, meshes=tuple(replace(mesh, vertices=factor * mesh.vertices) for mesh in of.meshes))


def test_characters_without_a_figure_are_refused(body: BodyModel) -> None:
    of = character(body)
    with pytest.raises(InputError, match="a character with meshes of triangles, found none"):
        fit_skeleton(replace(of, meshes=()), body)
    statue = nodes_at(["Statue"], np.array([-1]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    joints, weights = np.zeros((len(of.meshes[0].vertices), 1), dtype=int), torch.ones(len(of.meshes[0].vertices), 1)
    bare = mesh_of("Statue", of.meshes[0].vertices, of.meshes[0].faces, statue, joints, weights)
    with pytest.raises(InputError, match=r"expected a skinned mesh, with joints .* found none that is: Statue"):
        fit_skeleton(Character(statue, (replace(bare, is_rigid=True),), (), "statue.glb"), body)
    flat = replace(of.meshes[0], vertices=of.meshes[0].vertices * [1.0, 0.0, 1.0])
    with pytest.raises(InputError, match="found a height of 0"):
        fit_skeleton(replace(of, meshes=(flat,)), body)
    joint_map = automatic_joint_map(rest_clip(of))
    joint_map["Head"] = JointSource("mixamorig:Neck", "mixamorig:Head", 0.9)
    with pytest.raises(InputError, match="one joint each for Hips and Head, found Head = "):
        fit_skeleton(of, body, joint_map)


def test_body_of_our_own_body_is_our_body(body: BodyModel, twin: ImportedBody) -> None:
    imported = twin.body
    assert not boundary_loops(imported.faces.numpy())
    apart = distances_and_normals(body.rest_vertices[body.faces[body.scalp.faces]].mean(1), imported.rest_surface)[0]
    assert float(apart.abs().max()) < 2e-3
    assert joint_distance_mm(imported, body, ("Head", "Neck1", "LeftHand", "RightFoot")) < 0.1
    uv = torch.tensor([[0.5, 0.1], [0.5, 0.5], [0.2, 0.5], [0.8, 0.5], [0.5, 0.9]])
    places = []
    for each in (body, imported):
        faces, weights = each.scalp.locate(uv)
        assert (faces >= 0).all()
        places.append((weights[..., None] * each.rest_vertices[each.faces[faces]]).sum(1))
    assert float((places[0] - places[1]).norm(dim=1).max()) < 4e-3


def test_bob_on_it_drapes_as_on_ours(body: BodyModel, twin: ImportedBody) -> None:
    model = qf.load_model()
    pose = torch.zeros(1, 27, 3)
    pose[0, body.joint_names.index("Head")] = torch.tensor([0.3, 0.2, 0.3])
    hair, texels, inside = [], [], []
    for each in (body, twin.body):
        groom = qf.load_groom("bob", each)
        drape = model.on(each).drape(groom, pose.flatten(1))
        hair.append(drape[0])
        texels.append(groom.texels())
        scene = Scene(groom, BodyBatch(each, pose.flatten(1), torch.zeros(1, 10)))
        inside.append(float(intersection_percent(drape, scene)[0]))
    shared = np.intersect1d(*(each.numpy() for each in texels), return_indices=True)
    apart = (hair[0][shared[1]] - hair[1][shared[2]]).norm(dim=-1)
    assert len(shared[0]) > 0.95 * len(texels[0])
    assert float(apart.mean()) < 6e-3
    assert inside[1] <= 0.1


def test_groom_and_network_of_different_bodies_are_refused(body: BodyModel, twin: ImportedBody) -> None:
    """Roots on faces that are scalp on both bodies, too, which drape was silent about."""
    model, pose = qf.load_model(), torch.zeros(1, 81)
    shipped, own = qf.load_groom("bob").thinned(50), qf.load_groom("bob", twin.body).thinned(50)
    for on, groom in ((model, own), (model.on(twin.body), shipped)):
        with pytest.raises(InputError, match=r"bob: expected roots on the scalp .*load_model\(\).on\(body\) take"):
            on.drape(groom, pose)
    turned = replace(shipped, root_faces=body.scalp.faces[torch.arange(50)])
    with pytest.raises(InputError, match=r"found strands that begin \d+\.\d cm from theirs"):
        model.drape(turned, pose)
    assert model.on(twin.body).drape(own, pose).shape == (1, 50, 24, 3)


def test_drape_refuses_a_gradient_that_it_does_not_have(body: BodyModel) -> None:
    model, groom, pose = qf.load_model(), qf.load_groom("bob").thinned(8), torch.zeros(1, 81, requires_grad=True)
    with pytest.raises(InputError, match=r"body_pose: expected values without gradient.*TORCH\)\.deform has it"):
        model.drape(groom, pose)
    with pytest.raises(InputError, match="body_shape: expected values without gradient"):
        model.drape_many([groom], torch.zeros(1, 81), torch.zeros(1, 10, requires_grad=True))
    with torch.no_grad():
        assert model.drape(groom, pose).isfinite().all()


def test_gradient_through_the_pose_of_an_imported_body(twin: ImportedBody) -> None:
    model, imported = qf.load_model(), twin.body.to("cpu", torch.float64)
    groom = qf.load_groom("bob", twin.body).thinned(40).to(torch.float64)
    draper = NeuralDraper(model.draper.network.double(), model.draper.material, backend=Backend.TORCH)

    def tip_height(bend: torch.Tensor) -> torch.Tensor:
        pose = torch.zeros(1, 81, dtype=torch.float64)
        pose[0, 3 * imported.joint_names.index("Neck")] = bend
        bodies = BodyBatch(imported, pose, torch.zeros(1, 10, dtype=torch.float64))
        return draper.deform(Scene(groom, bodies))[0, :, -1, 2].mean()

    bend = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(tip_height(bend), bend)
    with torch.no_grad():
        difference = (tip_height(bend + 1e-6) - tip_height(bend - 1e-6)) / 2e-6
    assert abs(float(difference)) > 1e-3
    assert float(gradient) == pytest.approx(float(difference), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("head_scale", "longer"), [(WIDE_HEAD, (1.15, 1.35)), (NARROW_HEAD, (0.85, 1.15))])
def test_stylised_head_wears_bundled_grooms(
    body: BodyModel, head_scale: tuple[float, float, float], longer: tuple[float, float]
) -> None:
    stylised = import_body(character(body, head_scale=head_scale, centimetres=False), "1" * 64, body, COARSE).body
    own, other = (each.rest_vertices[each.faces[each.scalp.faces]].flatten(0, 1) for each in (body, stylised))
    ratio = (other.amax(0) - other.amin(0)) / (own.amax(0) - own.amin(0))
    np.testing.assert_allclose(ratio.numpy(), head_scale, atol=0.06)
    groom, shipped = qf.load_groom("bob", stylised), qf.load_groom("bob")
    distance = distances_and_normals(groom.rest_strands, stylised.rest_surface)[0]
    assert float(distance[:, 0].abs().max()) < 1e-4
    assert float((distance[:, 1:] < 0).float().mean()) < 1e-3
    assert longer[0] < float(groom.strand_lengths.mean() / shipped.strand_lengths.mean()) < longer[1]


def test_file_of_a_body(twin: ImportedBody, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    write_body(path, twin.body)
    read = qf.load_body(str(path))
    for name in ("rest_vertices", "rest_joints", "skin_weights", "faces"):
        torch.testing.assert_close(getattr(read, name), getattr(twin.body, name))
    assert read.origin is not None
    assert read.origin.joint_nodes[0] == "mixamorig:Hips"
    points = np.random.default_rng(0).normal(size=(9, 3))
    np.testing.assert_allclose(read.origin.body_from_file(read.origin.file_from_body(points)), points, atol=1e-12)
    assert qf.load_body().origin is None
    arrays = dict(np.load(path))
    del arrays["file_digest"]
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="all or none of the arrays"):
        qf.load_body(path)


def test_head_lies_where_it_lies_in_the_file(body: BodyModel, twin: ImportedBody) -> None:
    mesh, origin = character(body).meshes[0], twin.body.origin
    assert origin is not None
    head = np.flatnonzero(body.dense_skin_weights[:, body.joint_names.index("Head")].numpy() > 0.99)
    np.testing.assert_allclose(origin.body_from_file(mesh.vertices)[head], body.rest_vertices[head], atol=1e-4)


def test_skin_is_chosen_by_weights(body: BodyModel) -> None:
    eyed = with_hair_and_eye(character(body), body)
    imported = import_body(eyed, "", body, replace(COARSE, cell=0.012))
    notes = "; ".join(imported.notes)
    for what in ("skin: Body", "in the head: LeftEye", "hair, left out: Hair_Long"):
        assert what in notes


@pytest.mark.parametrize(
    "name",
    ["Skin_Brown", "eyes_brown", "Ludwig_Body", "Slash", "Chair", "Hairless", "armchair01", "Body", "", "Wigwam"],
)
def test_names_of_other_things(name: str) -> None:
    assert not is_hair_name(name)


@pytest.mark.parametrize(
    "name", ["Hair", "HAIR", "Hair_Long", "LongHair2", "longhair01", "F00_HairBack", "eyelashes01", "Ch09_Eyebrow",
             "wig", "Moustache.001", "ponytail01", "MIX-hair"]
)  # fmt: skip
def test_names_of_hair(name: str) -> None:
    assert is_hair_name(name)


def test_a_brown_skin_is_skin(body: BodyModel) -> None:
    of = character(body)
    brown = replace(of, meshes=(replace(of.meshes[0], name="Ludwig_Body", materials=("Skin_Brown",)),))
    (part,) = parts_of(brown, fit_skeleton(brown, body))
    assert not part.is_hair


def with_hair_and_eye(of: Character, body: BodyModel) -> Character:
    """The same with a ball in its head, and the skin of the scalp once more, larger, as hair."""
    mesh, node = of.meshes[0], of.nodes.names.index("mixamorig:Head")
    scalp = np.unique(body.faces[body.scalp.faces].numpy())
    faces = np.searchsorted(scalp, body.faces[body.scalp.faces].numpy())
    centre = mesh.vertices[scalp].mean(0)
    for name, size in (("LeftEye", 0.2), ("Hair_Long", 1.5)):
        vertices = centre + size * (mesh.vertices[scalp] - centre) - [0.0, 4.0 if size < 1 else 0.0, 0.0]
        joints, weights = np.full((len(scalp), 1), node), torch.ones(len(scalp), 1)
        of = with_mesh(of, mesh_of(name, vertices, faces, of.nodes, joints, weights))
    return of


@pytest.mark.slow
def test_scalp_of_a_hair_mesh(body: BodyModel) -> None:
    haired = with_hair_and_eye(character(body), body)
    settings = replace(COARSE, hair_mesh="Hair_Long", cell=0.012)
    with pytest.raises(InputError, match="--hair-mesh LeftEye: expected a scalp of at least"):
        import_body(haired, "", body, replace(settings, hair_mesh="LeftEye"))
    mesh = haired.meshes[2]
    near = mesh.vertices.mean(0) + 0.68 * (mesh.vertices - mesh.vertices.mean(0))
    fitting = mesh_of("Wig", near, mesh.faces, haired.nodes, mesh.joints, torch.from_numpy(mesh.weights))
    imported = import_body(with_mesh(character(body), fitting), "", body, replace(settings, hair_mesh="wig"))
    assert len(imported.body.scalp.faces) > 200


@pytest.mark.slow
def test_what_is_worn_on_the_head_is_no_part_of_it(body: BodyModel) -> None:
    """A hat of twice the width made the head 1.3 times as wide, and its scalp and its grooms with it."""
    of, settings = with_hair_and_eye(character(body), body), replace(COARSE, cell=0.012)
    hat = of.meshes[2]
    high = hat.vertices[hat.faces].mean(1)[:, 1] > hat.vertices[:, 1].mean()
    felt = replace(hat, name="Hat", materials=("Felt",), faces=hat.faces[high], face_materials=hat.face_materials[high])
    hatted = replace(of, meshes=(*of.meshes[:2], felt))
    bare, worn = (import_body(hatted, "", body, replace(settings, collide=names)) for names in ((), ("hat",)))
    assert worn.notes[0].split("; ")[1] == bare.notes[0].split("; ")[1]
    assert "hair collides with: Hat (Felt)" in worn.notes
    assert worn.notes[-1] == "hair grows on the outside of Hat (Felt)"
    assert float(worn.body.rest_vertices[:, 2].max() - bare.body.rest_vertices[:, 2].max()) > 0.01


@pytest.mark.slow
def test_scalp_of_an_attribute(body: BodyModel) -> None:
    """Vertices above 0.5 are scalp, under hair that is nearer to the surface than they are; a name has an underscore in
    the file alone."""
    of = character(body)
    values = np.zeros(len(body.rest_vertices), np.float32)
    values[np.unique(body.faces[body.scalp.faces].numpy())] = 0.51
    (mesh,) = of.meshes
    painted = replace(of, meshes=(replace(mesh, attributes={"_SCALP": values, "_MASK": 0 * values + 0.5}),))
    covered = with_mesh(painted, replace(mesh, name="Hair", materials=("Hair",)))
    settings = replace(COARSE, cell=0.012)
    scalp = import_body(covered, "", body, replace(settings, scalp="Scalp")).body
    own, other = (each.rest_vertices[each.faces[each.scalp.faces]].mean(1) for each in (body, scalp))
    for there, back in ((own, other), (other, own)):
        assert float(torch.cdist(there, back).amin(1).max()) < 0.02
    assert patch_area(scalp) == pytest.approx(patch_area(body), rel=0.1)
    (part,) = parts_of(painted, fit_skeleton(painted, body))
    for name in ("_scalp", "SCALP", "sc*"):
        np.testing.assert_array_equal(part.attribute(name), values)
    assert part.attribute("body") is None
    with pytest.raises(InputError, match=r"--scalp _mask: expected a scalp"):
        import_body(covered, "", body, replace(settings, scalp="_mask"))
    expected = r"expected a mesh or material of character.glb \(Body \(BodyMaterial\), .*its vertices \(_SCALP, _MASK\)"
    with pytest.raises(InputError, match=expected):
        import_body(covered, "", body, replace(settings, scalp="crown"))


def patch_area(of: BodyModel) -> float:
    """Area of the scalp [m^2]."""
    a, b, c = of.rest_vertices[of.faces[of.scalp.faces]].unbind(1)
    return float(0.5 * torch.linalg.cross(b - a, c - a).norm(dim=1).sum())


@pytest.mark.parametrize("axis", range(3))
def test_a_stray_vertex_is_refused_before_there_is_a_grid_around_it(axis: int, body: BodyModel) -> None:
    """100 km aside; in a jacket, too, which nothing asks for unless it is named."""
    of = character(body)
    (mesh,) = of.meshes
    vertices = mesh.vertices.copy()
    vertices[77, axis] = 1e7
    stray = replace(of, meshes=(replace(mesh, vertices=vertices),))
    with pytest.raises(InputError, match=r"character.glb, mesh Body: expected a mesh within 4 heights of the figure"):
        import_body(stray, "", body, COARSE)
    prop = with_mesh(of, replace(mesh, name="Sky", vertices=vertices, is_rigid=True))
    with pytest.raises(InputError, match=r"character.glb, mesh Sky \(BodyMaterial\): expected a mesh within"):
        import_body(prop, "", body, replace(COARSE, collide=("sky",)))


def test_errors_say_what_was_expected(body: BodyModel) -> None:
    of = character(body)
    headless = character(body, {name: joint for name, joint in MIXAMO.items() if name != "Head"})
    with pytest.raises(InputError, match=r"none for .*Head"):
        import_body(headless, "", body, COARSE)
    second = {**MIXAMO, "head": "LeftHand"}
    with pytest.raises(InputError, match="2 heads: mixamorig:Head and mixamorig:head for Head"):
        import_body(character(body, second), "", body, COARSE)
    mesh = of.meshes[0]
    bald = replace(of, meshes=(replace(mesh, name="Hair"),))
    with pytest.raises(InputError, match="expected a skinned mesh that the head moves, other than hair"):
        import_body(bald, "", body, COARSE)
    with pytest.raises(InputError, match="--collide: expected a mesh or material"):
        import_body(of, "", body, replace(COARSE, collide=("Dress",)))
