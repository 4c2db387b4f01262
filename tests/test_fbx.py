"""Characters read from FBX files: the same as from glTF files of them, in every unit, axes and layout of the format."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.body import Character, poses_at
from quaffure.io.read_character import read_character
from tests.fbx_characters import ORDERS, FbxForm, fbx_of
from tests.fbx_file import FbxFile, Record, listed
from tests.gltf_files import NAMES, GltfFile, figure

QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


def read(file: FbxFile | bytes, folder: Path, version: int = 7400, is_deflated: bool = False) -> Character:
    path = folder / "file.fbx"
    path.write_bytes(file if isinstance(file, bytes) else file.content(version, is_deflated))
    return read_character(path)


def moving_figure(folder: Path) -> Character:
    """A figure whose joints turn and whose hips travel, as glTF has it."""
    random = np.random.default_rng(1)
    steps = 0.2 * random.normal(size=(12, len(NAMES), 3))
    turned = Rotation.from_rotvec(np.cumsum(steps, axis=0).reshape(-1, 3)).as_matrix()
    path = folder / "file.glb"
    path.write_bytes(figure(turned.reshape(12, len(NAMES), 3, 3), 90 + random.normal(size=(12, 3))).glb())
    return read_character(path)


FORMS = {
    "metres": (FbxForm(100.0), 7400, False),
    "centimetres": (FbxForm(), 7400, False),
    "z up": (FbxForm(is_z_up=True), 7300, True),
    "inches, z up": (FbxForm(2.54, is_z_up=True), 7100, False),
    "rotations before and after": (FbxForm(is_turned=True), 7400, False),
    "64 bits": (FbxForm(), 7500, False),
    "zlib streams": (FbxForm(is_z_up=True, is_turned=True), 7700, True),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_figure_is_the_one_of_its_gltf_file(name: str, tmp_path: Path) -> None:
    expected = moving_figure(tmp_path)
    form, version, is_deflated = FORMS[name]
    found = read(fbx_of(expected, form), tmp_path, version, is_deflated)
    assert found.nodes.names == ("RootNode", *expected.nodes.names)
    np.testing.assert_allclose(found.nodes.world[1:, :3, 3], expected.nodes.world[:, :3, 3], atol=1e-5)
    (mesh,), (other,) = found.meshes, expected.meshes
    assert (mesh.name, mesh.materials, mesh.is_rigid) == ("Body", ("Skin",), False)
    np.testing.assert_allclose(mesh.vertices, other.vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, other.faces)
    np.testing.assert_array_equal(mesh.joints[:, 0], other.joints[:, 0] + 1)
    np.testing.assert_allclose(mesh.weights, np.ones((len(mesh.vertices), 1)))
    ((animation,), (same,)) = found.animations, expected.animations
    assert animation.name == "moves"
    np.testing.assert_allclose(animation.span, same.span, atol=1e-6)
    times = same.channels[0].times
    (poses,), (others,) = poses_at(found, animation, times), poses_at(expected, same, times)
    np.testing.assert_allclose(poses.world[:, 1:, :3, 3], others.world[..., :3, 3], atol=1e-5)
    turns = [world[..., :3, :3] / np.linalg.norm(world[..., :3, :3], axis=-2, keepdims=True)
             for world in (poses.world[:, 1:], others.world)]  # fmt: skip
    apart = Rotation.from_matrix((turns[0].mT @ turns[1]).reshape(-1, 3, 3))
    assert apart.magnitude().max() < 1e-4
    for frame in (3, 11):
        np.testing.assert_allclose(mesh.posed(poses.world[frame]), other.posed(others.world[frame]), atol=1e-5)


def euler(order: str, angles: tuple[float, ...]) -> np.ndarray:
    """The matrix of angles about three axes, one after another."""
    matrix = np.eye(4)
    for axis in order:
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_euler(axis, angles["xyz".index(axis)], degrees=True).as_matrix()
        matrix = turn @ matrix
    return matrix


def moved(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


TRANSFORM = {
    "Lcl__Translation": (1.0, 2.0, 3.0), "Lcl__Rotation": (20.0, -50.0, 70.0), "Lcl__Scaling": (2.0, 3.0, 0.5),
    "PreRotation": (10.0, 80.0, -30.0), "PostRotation": (-25.0, 15.0, 60.0), "RotationPivot": (1.0, 0.0, 4.0),
    "RotationOffset": (0.0, 7.0, 1.0), "ScalingPivot": (3.0, 1.0, 1.0), "ScalingOffset": (-1.0, 2.0, 0.0),
}  # fmt: skip


def product(order: str) -> np.ndarray:
    """T Roff Rp Rpre R Rpost^-1 Rp^-1 Soff Sp S Sp^-1, factor by factor."""
    of = TRANSFORM
    pivot, scaling_pivot = moved(*of["RotationPivot"]), moved(*of["ScalingPivot"])
    return (
        moved(*of["Lcl__Translation"]) @ moved(*of["RotationOffset"]) @ pivot
        @ euler("xyz", of["PreRotation"]) @ euler(order, of["Lcl__Rotation"])
        @ np.linalg.inv(euler("xyz", of["PostRotation"])) @ np.linalg.inv(pivot)
        @ moved(*of["ScalingOffset"]) @ scaling_pivot @ np.diag([*of["Lcl__Scaling"], 1]) @ np.linalg.inv(scaling_pivot)
    )  # fmt: skip


@pytest.mark.parametrize("order", ORDERS)
def test_a_transform_is_the_product_of_its_eleven_factors(order: str, tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    file.model("a", RotationActive=True, RotationOrder=ORDERS.index(order), **TRANSFORM)
    np.testing.assert_allclose(read(file, tmp_path).nodes.world[1], product(order), atol=1e-12)


def test_rotations_that_are_not_active_and_properties_of_the_template(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    file.model("a", PreRotation=(90.0, 0.0, 0.0), RotationOrder=4, Lcl__Rotation=(0.0, 30.0, 40.0))
    file.model("b", RotationActive=True)
    file.model("c", RotationActive=True, PreRotation=(0.0, 0.0, 0.0))
    template = Record("PropertyTemplate", ["FbxNode"], [listed(PreRotation=(0.0, 0.0, 90.0))])
    file.definitions.children.append(Record("ObjectType", ["Model"], [Record("Count", [3]), template]))
    _, first, second, third = read(file, tmp_path).nodes.world
    np.testing.assert_allclose(first, euler("xyz", (0.0, 30.0, 40.0)), atol=1e-12)
    np.testing.assert_allclose(second, euler("xyz", (0.0, 0.0, 90.0)), atol=1e-12)
    np.testing.assert_allclose(third, np.eye(4), atol=1e-12)


def test_transforms_of_geometry_are_the_mesh_s_alone(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    geometric = {"GeometricTranslation": (1.0, 2.0, 3.0), "GeometricRotation": (0.0, 0.0, 90.0),
                 "GeometricScaling": (2.0, 2.0, 2.0)}  # fmt: skip
    holder = file.model("a", kind="Mesh", Lcl__Translation=(0.0, 0.0, 5.0), **geometric)
    file.geometry(holder, CUBE, QUADS)
    file.model("b", holder)
    found = read(file, tmp_path)
    expected = 2 * CUBE @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + np.array([1, 2, 8])
    np.testing.assert_allclose(found.meshes[0].vertices, expected, atol=1e-12)
    assert found.meshes[0].is_rigid
    np.testing.assert_allclose(found.nodes.world[2], moved(0, 0, 5), atol=1e-12)


def volume(character: Character) -> float:
    (mesh,) = character.meshes
    return float(np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6)


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (-2.0, 1.0, 1.0)])
def test_polygons_are_triangles_that_point_outwards(scale: tuple[float, float, float], tmp_path: Path) -> None:
    """Quads, triangles and a pentagon; points and lines are left out."""
    file = FbxFile(unit=100.0)
    polygons = [*QUADS[:-1], QUADS[-1][:3], [QUADS[-1][0], *QUADS[-1][2:]], [0], [3, 4]]
    file.geometry(file.model("a", Lcl__Scaling=scale), CUBE, polygons)
    found = read(file, tmp_path)
    assert len(found.meshes[0].faces) == 12
    assert volume(found) == pytest.approx(abs(np.prod(scale)))
    pentagon = FbxFile(unit=100.0)
    pentagon.geometry(pentagon.model("a"), CUBE[:5], [[4, 3, 2, 1, 0]])
    np.testing.assert_array_equal(read(pentagon, tmp_path).meshes[0].faces, [[4, 3, 2], [4, 2, 1], [4, 1, 0]])


def kind(mapping: str) -> Record:
    return Record("MappingInformationType", [mapping])


@pytest.mark.parametrize("is_indexed", [True, False])
def test_vertices_are_divided_where_texture_coordinates_differ(is_indexed: bool, tmp_path: Path) -> None:
    corners = np.array([*QUADS[:2], [0, 4, 5, 1]]).reshape(-1)
    uv = np.float64([[0.25 * corner, 0.5] for corner in corners])
    uv[8] = 0.9, 0.1  # vertex 0 once more, elsewhere
    rows = [Record("UV", [(uv[::-1] if is_indexed else uv).reshape(-1).copy()])]
    rows += [Record("UVIndex", [np.int32(np.arange(12)[::-1])])] if is_indexed else []
    file = FbxFile(unit=100.0)
    layer = Record("LayerElementUV", [0], [kind("ByPolygonVertex"), *rows])
    file.geometry(file.model("a"), CUBE, [*QUADS[:2], [0, 4, 5, 1]], layer)
    (mesh,) = read(file, tmp_path).meshes
    assert mesh.uv is not None
    assert len(mesh.vertices) == 9
    where = np.flatnonzero((mesh.vertices == CUBE[0]).all(axis=1))
    assert sorted(mesh.uv[where].tolist()) == [[0.0, 0.5], [0.9, 0.9]]
    corner = mesh.faces[4, 0]  # the first of the third quad
    np.testing.assert_allclose([*mesh.vertices[corner], *mesh.uv[corner]], [*CUBE[0], 0.9, 0.9])


def test_materials_by_polygon_and_for_all(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    by_polygon = Record("LayerElementMaterial", [0], [kind("ByPolygon"),
                        Record("Materials", [np.int32([1, 1, 0, 0, 0, 7])])])  # fmt: skip
    for_all = Record("LayerElementMaterial", [0], [kind("AllSame"), Record("Materials", [np.int32([0])])])
    for layer in (by_polygon, for_all):
        holder = file.model("a")
        file.geometry(holder, CUBE, QUADS, layer)
        for name in ("skin", "hair"):
            file.connect(file.add("Material", "", name), holder)
    first, second = read(file, tmp_path).meshes
    assert (first.name, second.name) == ("a", "a#2")
    assert [first.materials[index] for index in first.face_materials[::2]] == ["hair", "hair", *["skin"] * 3, ""]
    assert second.materials == ("skin",)


def test_weights_of_several_joints_of_none_and_of_too_many(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    holder = file.model("a", Lcl__Translation=(0.0, 0.0, 9.0))
    geometry = file.geometry(holder, CUBE, QUADS)
    skin = file.skin(geometry)
    mesh = moved(0, 0, 9)
    for joint in range(40):
        bone = moved(joint, 0, 0)
        at = file.model(f"joint{joint}", Lcl__Translation=(float(joint), 0.0, 0.0))
        vertices, weights = ([0, 1], [3.0, 1.0]) if joint == 0 else ([1], [1.0 + 0.001 * joint])
        file.cluster(skin, at, np.array(vertices), np.array(weights), mesh, bone)
    (found,) = read(file, tmp_path).meshes
    assert found.weights.shape == (8, 32)
    np.testing.assert_allclose(found.weights.sum(1), 1)
    np.testing.assert_allclose(found.weights[0, :2], [1, 0])
    assert found.joints[1].min() == 10  # the eight weakest joints are left out
    assert (found.joints[2:, 0] == 1).all()  # what nothing moves is on its node
    np.testing.assert_allclose(found.vertices, CUBE + np.array([0, 0, 9]), atol=1e-12)


def bound_pair(lifted: float = 0.0) -> FbxFile:
    """Two joints and a cube that were bound one metre apart; the second is lifted afterwards."""
    file = FbxFile(unit=100.0)
    above = file.model("above", Lcl__Translation=(0.0, 2.0, 0.0))
    below = file.model("below", above, Lcl__Translation=(0.0, 1.0 + lifted, 0.0))
    file.model("end", below, Lcl__Translation=(0.0, 1.0, 0.0))
    skin = file.skin(file.geometry(file.model("a", kind="Mesh"), CUBE, QUADS))
    file.cluster(skin, above, np.arange(4), np.ones(4), np.eye(4), moved(0, 2, 0))
    file.cluster(skin, below, np.arange(4, 8), np.ones(4), np.eye(4), moved(0, 3, 0))
    return file


def test_a_character_is_at_rest_where_it_was_bound(tmp_path: Path) -> None:
    """Models stand where they are in a frame of the animation, which is kept."""
    file = bound_pair(lifted=5.0)
    layer = file.stack("nods")
    file.curve(file.curve_node(layer, 1001, "Lcl Rotation"), "d|X", np.array([0.0, 1.0]), np.array([0.0, 0.0]))
    found = read(file, tmp_path)
    np.testing.assert_allclose(found.nodes.world[1:4, 1, 3], [2, 3, 4], atol=1e-12)
    np.testing.assert_allclose(found.meshes[0].vertices, CUBE, atol=1e-12)
    (pose,) = poses_at(found, found.animations[0], np.array([0.5]))
    np.testing.assert_allclose(pose.world[0, 1:4, 1, 3], [2, 8, 9], atol=1e-12)
    lifted = CUBE + np.repeat([[0, 0, 0], [0, 5, 0]], 4, axis=0)
    np.testing.assert_allclose(found.meshes[0].posed(pose.world[0]), lifted, atol=1e-12)


def test_poses_of_nodes_that_move_no_vertex(tmp_path: Path) -> None:
    file = bound_pair(lifted=5.0)
    nodes = [
        Record(
            "PoseNode", [], [Record("Node", [np.int64(1000 + index)]), Record("Matrix", [moved(0, y, 0).T.reshape(-1)])]
        )
        for index, y in ((2, 3.0), (3, 7.0))
    ]
    pose = file.add("Pose", "BindPose", "pose", *nodes)
    np.testing.assert_allclose(read(file, tmp_path).nodes.world[1:4, 1, 3], [2, 3, 7], atol=1e-12)
    # One that places a joint elsewhere than its cluster is not of the mesh.
    file.object(pose).child("PoseNode#0/Matrix").properties = [moved(0, 9, 0).T.reshape(-1)]
    np.testing.assert_allclose(read(file, tmp_path).nodes.world[1:4, 1, 3], [2, 3, 4], atol=1e-12)


def test_matrices_that_contradict_each_other_leave_models_as_they_are(tmp_path: Path) -> None:
    file = bound_pair(lifted=5.0)
    file.object(1008).child("TransformLink").properties = [moved(0, 4, 0).T.reshape(-1)]
    np.testing.assert_allclose(read(file, tmp_path).nodes.world[1:4, 1, 3], [2, 8, 9], atol=1e-12)


def test_a_mesh_that_was_bound_in_another_unit_than_joints_are_in(tmp_path: Path) -> None:
    """Bound in centimetres; a joint makes metres of them, and has moved since."""
    file = bound_pair(lifted=5.0)
    file.object(1001).child("Properties70").children += listed(Lcl__Scaling=(0.01, 0.01, 0.01)).children
    layer = file.stack("nods")
    file.curve(file.curve_node(layer, 1001, "Lcl Rotation"), "d|X", np.array([0.0, 1.0]), np.array([0.0, 0.0]))
    found = read(file, tmp_path)
    np.testing.assert_allclose(found.nodes.world[1:4, 1, 3], [2, 2.01, 2.02], atol=1e-12)
    np.testing.assert_allclose(found.meshes[0].vertices, 0.01 * CUBE + np.array([0, 1.98, 0]), atol=1e-12)
    (pose,) = poses_at(found, found.animations[0], np.array([0.5]))
    np.testing.assert_allclose(pose.world[0, 1:4, 1, 3], [2, 2.06, 2.07], atol=1e-12)


@pytest.mark.parametrize("how", [0, 1, 2])
def test_scales_from_above(how: int, tmp_path: Path) -> None:
    """An even one is the same in the first two ways; in the third the parent's own is left out."""
    file = FbxFile(unit=100.0)
    above = file.model("a", Lcl__Scaling=(2.0, 2.0, 2.0))
    parent = file.model("b", above, Lcl__Scaling=(3.0, 3.0, 3.0))
    file.model("c", parent, InheritType=how, Lcl__Translation=(1.0, 0.0, 0.0), Lcl__Scaling=(1.0, 2.0, 5.0))
    world = read(file, tmp_path).nodes.world[3]
    np.testing.assert_allclose(world[:3, 3], [6, 0, 0], atol=1e-12)
    np.testing.assert_allclose(np.diag(world)[:3], (2.0 if how == 2 else 6.0) * np.array([1, 2, 5]), atol=1e-12)
    file.object(parent).child("Properties70/P").properties[4:] = [3.0, 3.0, 4.0]
    if how == 1:
        assert read(file, tmp_path).nodes.world[3, 2, 2] == pytest.approx(2 * 4 * 5)
        return
    with pytest.raises(InputError, match="the same scale along all axes above a model of InheritType 0 or 2"):
        read(file, tmp_path)


def test_morph_targets_and_sliders_of_several_shapes(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    geometry = file.geometry(file.model("a"), CUBE, QUADS)
    blend = file.add("Deformer", "BlendShape", "shapes")
    file.connect(blend, geometry)
    for name, full in (("smile", [100.0]), ("blink", [40.0, 100.0])):
        channel = file.add("Deformer", "BlendShapeChannel", name, listed(DeformPercent=70.0),
                           Record("FullWeights", [np.array(full)]))  # fmt: skip
        file.connect(channel, blend)
        for height in full:
            file.connect(file.add("Geometry", "Shape", name, Record("Indexes", [np.int32([5])]),
                                  Record("Vertices", [np.float64([0, height, 0])])), channel)  # fmt: skip
    (mesh,) = read(file, tmp_path).meshes
    assert list(mesh.morph_targets) == ["smile", "blink", "blink 1"]
    np.testing.assert_allclose(mesh.morph_weights, [0.7, 0.5, 0.5])
    assert mesh.vertices[5, 1] == pytest.approx(CUBE[5, 1] + 0.7 * 100 + 0.5 * 40 + 0.5 * 100)
    assert list(mesh.morph_targets["smile"].any(axis=1)).count(True) == 1


@pytest.mark.parametrize(
    ("percent", "expected"),
    [
        (-5, [0, 0, 0]), (0, [0, 0, 0]), (10, [0.25, 0, 0]), (40, [1, 0, 0]), (55, [0.75, 0.25, 0]),
        (100, [0, 1, 0]), (115, [0, 0.5, 0.5]), (130, [0, 0, 1]), (200, [0, 0, 1]),
    ],
)  # fmt: skip
def test_shapes_of_a_slider_are_mixed_by_twos(percent: float, expected: list[float], tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    geometry = file.geometry(file.model("a"), CUBE, QUADS)
    blend = file.add("Deformer", "BlendShape", "shapes")
    file.connect(blend, geometry)
    channel = file.add("Deformer", "BlendShapeChannel", "blink", listed(DeformPercent=float(percent)),
                       Record("FullWeights", [np.array([40.0, 100, 130])]))  # fmt: skip
    file.connect(channel, blend)
    for index in range(3):
        file.connect(file.add("Geometry", "Shape", f"{index}"), channel)
    np.testing.assert_allclose(read(file, tmp_path).meshes[0].morph_weights, expected, atol=1e-12)


def test_other_records_among_connections_are_left_out(tmp_path: Path) -> None:
    file = bound_pair()
    file.connections.children.insert(0, Record("Version", [100]))
    assert len(read(file, tmp_path).nodes) == 5


def test_two_figures_of_one_name_and_names_of_bytes(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    for name in ("Thing", "Thing", "Thing\n\x1b[31m", "RootNode"):
        file.model(name)
    names = read(file, tmp_path).nodes.names
    assert names == ("RootNode#2", "Thing", "Thing#2", "Thing  [31m", "RootNode")
    mesh = GltfFile()
    mesh.add("nodes", name="a")
    (tmp_path / "a.fbx").write_bytes(mesh.glb())
    with pytest.raises(InputError, match=r"a binary FBX file of version 7\.1 to 7\.7 .*, found another file"):
        read_character(tmp_path / "a.fbx")
