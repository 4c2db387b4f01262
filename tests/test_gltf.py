"""Characters read from glTF files: every layout of arrays, transforms, skins; damaged files are refused in one line."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.body import Character
from quaffure.io.read_character import read_character
from tests.gltf_files import NAMES, PLACES, GltfFile, figure
from tests.meshopt_streams import compressed

TRIANGLE = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def read(file: GltfFile | bytes, folder: Path, suffix: str = ".glb") -> Character:
    path = folder / f"file{suffix}"
    content = file if isinstance(file, bytes) else file.glb() if suffix == ".glb" else file.gltf()
    path.write_bytes(content)
    return read_character(path)


def mesh_file(positions: int | None = None, file: GltfFile | None = None, **primitive: Any) -> GltfFile:
    """Four vertices on a node of their own."""
    file = GltfFile() if file is None else file
    positions = file.accessor(TRIANGLE) if positions is None else positions
    file.add("meshes", primitives=[{"attributes": {"POSITION": positions}, **primitive}])
    file.add("nodes", name="Thing", mesh=0)
    return file


def with_indices(file: GltfFile, corners: list[int], **primitive: Any) -> GltfFile:
    return mesh_file(file=file, indices=file.accessor(np.uint8(corners)), **primitive)


@pytest.mark.parametrize("form", ["binary", "embedded", "beside"])
def test_a_figure_is_read_from_every_form(form: str, tmp_path: Path) -> None:
    file = figure()
    (tmp_path / "a b.bin").write_bytes(file.binary)
    content = {"binary": file.glb, "embedded": file.gltf, "beside": lambda: file.gltf("a%20b.bin")}[form]()
    found = read(content, tmp_path, ".glb" if form == "binary" else ".gltf")
    assert found.nodes.names == ("Armature", *(f"mixamorig:{name}" for name in depth_first()), "Body")
    (mesh,) = found.meshes
    assert (mesh.name, mesh.materials, mesh.is_rigid, len(mesh.faces)) == ("Body", ("Skin",), False, 4 * len(NAMES))
    joints = [found.nodes.names.index(f"mixamorig:{name}") for name in NAMES]
    np.testing.assert_allclose(found.nodes.world[joints, :3, 3], 0.01 * PLACES, atol=1e-6)
    np.testing.assert_allclose(mesh.vertices[::4], 0.01 * PLACES, atol=1e-6)
    np.testing.assert_array_equal(mesh.joints[:, 0], np.repeat(joints, 4))
    assert (mesh.weights.sum(1) == 1).all()


def depth_first(parent: str = "") -> list[str]:
    from tests.gltf_files import MIXAMO

    return [name for child, (above, _) in MIXAMO.items() if above == parent for name in (child, *depth_first(child))]


def test_positions_and_faces_are_those_that_trimesh_reads(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    file = with_indices(GltfFile(), [0, 2, 1, 0, 1, 3])
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.3, -1, 2]).as_matrix() * [2, 3, 0.5]
    matrix[:3, 3] = 1, 2, 3
    file.document["nodes"][0]["matrix"] = matrix.T.flatten().tolist()
    file.document["nodes"] = [{"name": "Above", "children": [1], "rotation": [0.5, 0.5, -0.5, 0.5],
                               "translation": [0, 5, 0]}, *file.document["nodes"]]  # fmt: skip
    file.document |= {"scene": 0, "scenes": [{"nodes": [0]}]}
    found = read(file, tmp_path).meshes[0]
    scene = trimesh.load(tmp_path / "file.glb")
    (expected,) = scene.dump()
    np.testing.assert_allclose(found.vertices, expected.vertices, atol=1e-6)
    np.testing.assert_array_equal(found.faces, expected.faces)
    assert found.is_rigid


def interleaved(file: GltfFile) -> int:
    rows = np.hstack([TRIANGLE, np.full((4, 2), 9, np.float32)])
    view = file.view(b"...." + rows.tobytes(), byteStride=20)
    return file.add("accessors", bufferView=view, byteOffset=4, count=4, componentType=5126, type="VEC3")


def quantised(file: GltfFile) -> int:
    return file.accessor(np.uint16(65535 * TRIANGLE), normalized=True)


def signed(file: GltfFile) -> int:
    padded = np.hstack([np.int8(127 * TRIANGLE), np.zeros((4, 1), np.int8)])
    view = file.view(padded.tobytes(), byteStride=4)
    return file.add("accessors", bufferView=view, count=4, componentType=5120, type="VEC3", normalized=True)


def plain_integers(file: GltfFile) -> int:
    return file.accessor(np.int16(TRIANGLE))


def sparse(file: GltfFile) -> int:
    values = {"bufferView": file.view(TRIANGLE[[1, 3]].tobytes())}
    indices = {"bufferView": file.view(np.uint8([1, 3]).tobytes()), "componentType": 5121}
    changed = {"count": 2, "indices": indices, "values": values}
    base = TRIANGLE.copy()
    base[[1, 3]] = 7
    return file.accessor(base, sparse=changed)


def sparse_alone(file: GltfFile) -> int:
    values = {"bufferView": file.view(TRIANGLE[1:].tobytes())}
    indices = {"bufferView": file.view(np.uint16([1, 2, 3]).tobytes()), "componentType": 5123}
    return file.add("accessors", count=4, componentType=5126, type="VEC3",
                    sparse={"count": 3, "indices": indices, "values": values})  # fmt: skip


def meshopt(file: GltfFile) -> int:
    return compressed(file, TRIANGLE)


LAYOUTS = (meshopt, interleaved, quantised, signed, plain_integers, sparse, sparse_alone)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_layouts_of_arrays(layout: Callable[[GltfFile], int], tmp_path: Path) -> None:
    file = GltfFile()
    found = read(mesh_file(layout(file), file, mode=5), tmp_path)
    np.testing.assert_allclose(found.meshes[0].vertices, TRIANGLE, atol=1e-6)


@pytest.mark.parametrize(
    ("mode", "faces"), [(4, [[0, 1, 2]]), (5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]])]
)
def test_modes_of_triangles(mode: int, faces: list[list[int]], tmp_path: Path) -> None:
    corners = [0, 1, 2] if mode == 4 else [0, 1, 2, 3]
    found = read(with_indices(GltfFile(), corners, mode=mode), tmp_path)
    np.testing.assert_array_equal(found.meshes[0].faces, faces)
    assert not read(with_indices(GltfFile(), corners, mode=1), tmp_path).meshes


def test_meshes_under_moved_nodes_in_the_scene(tmp_path: Path) -> None:
    """Hidden nodes are left out, equal names differ, and parts that share vertices are one mesh."""
    file = with_indices(GltfFile(), [0, 1, 2])
    primitive = file.document["meshes"][0]["primitives"][0]
    file.document["meshes"][0]["primitives"].append({**primitive, "material": 1})
    file.document["materials"] = [{"name": "a"}, {"name": "hair"}]
    file.document["nodes"] = [
        {"name": "Thing", "mesh": 0, "scale": [-2, 2, 2]},
        {"name": "Above", "children": [0], "translation": [1, 0, 0]},
        {"name": "Thing", "mesh": 0},
        {"name": "Thing\n\x1b[31m", "mesh": 0},
    ]
    file.document |= {"scenes": [{"nodes": [2]}, {"nodes": [1, 3]}], "scene": 1}
    found = read(file, tmp_path)
    assert found.nodes.names == ("Above", "Thing", "Thing#2", "Thing  [31m")
    assert [mesh.name for mesh in found.meshes] == ["Thing", "Thing  [31m"]
    mesh = found.meshes[0]
    np.testing.assert_allclose(mesh.vertices, TRIANGLE * np.array([-2, 2, 2]) + np.array([1, 0, 0]), atol=1e-6)
    assert (mesh.materials, mesh.face_materials.tolist(), len(mesh.vertices)) == (("", "hair"), [0, 1], 4)
    with pytest.raises(InputError, match=r"a mesh 'x', found the meshes Thing, Thing"):
        found.mesh("x")


@pytest.mark.parametrize("is_skinned", [False, True])
@pytest.mark.parametrize("scale", [[1, 1, 1], [-2, 2, 2], [-1, -1, 1], [-1, -1, -1]])
def test_faces_of_mirrored_nodes_stay_counterclockwise(scale: list[int], is_skinned: bool, tmp_path: Path) -> None:
    """A tetrahedron's volume stays above 0; the node of a skinned mesh changes nothing."""
    file = GltfFile()
    attributes = {
        "POSITION": file.accessor(TRIANGLE), "JOINTS_0": file.accessor(np.zeros((4, 4), np.uint8)),
        "WEIGHTS_0": file.accessor(np.float32([[1, 0, 0, 0]] * 4)),
    }  # fmt: skip
    with_indices(file, [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], attributes=attributes)
    file.document["nodes"] += [{"children": [0], "scale": scale}, {"name": "Joint"}]
    if is_skinned:
        file.document["skins"] = [{"joints": [2]}]
        file.document["nodes"][0]["skin"] = 0
    mesh = read(file, tmp_path).meshes[0]
    volume = np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6
    np.testing.assert_allclose(volume, 1 / 6 if is_skinned else abs(np.prod(scale)) / 6, atol=1e-6)


def test_weights_morph_targets_and_more_than_four_joints(tmp_path: Path) -> None:
    file = mesh_file(indices=None)
    del file.document["meshes"][0]["primitives"][0]["indices"]
    primitive = file.document["meshes"][0]["primitives"][0] | {"mode": 6}
    primitive["attributes"] |= {
        "JOINTS_0": file.accessor(np.uint8([[0, 1, 0, 0]] * 4)),
        "JOINTS_1": file.accessor(np.uint16([[1, 0, 0, 0]] * 4)),
        "WEIGHTS_0": file.accessor(np.uint8([[51, 51, 0, 0]] * 3 + [[0] * 4]), normalized=True),
        "WEIGHTS_1": file.accessor(np.float32([[0.6, 0, 0, 0]] * 3 + [[0] * 4])),
        "TEXCOORD_0": file.accessor(np.float32(np.arange(8).reshape(4, 2))),
    }  # fmt: skip
    primitive["targets"] = [{"POSITION": file.accessor(np.float32([[0, 0, 2]] * 4))}, {}]
    file.document["meshes"][0] |= {
        "primitives": [primitive], "weights": [0.5, 0], "extras": {"targetNames": ["blink"]},
    }  # fmt: skip
    file.document["nodes"][0] |= {"skin": 0, "translation": [9, 9, 9]}
    file.document["nodes"] += [{"name": "a", "translation": [1, 0, 0]}, {"name": "b", "translation": [0, 1, 0]}]
    file.document["skins"] = [{"joints": [1, 2]}]
    mesh = read(file, tmp_path).meshes[0]
    assert mesh.skin_joints.shape == mesh.weights.shape == (4, 8)
    np.testing.assert_allclose(mesh.weights[0, [0, 1, 4]], [0.2, 0.2, 0.6], atol=1e-6)
    expected = TRIANGLE + np.array([0, 0, 1]) + np.array([[0.2, 0.8, 0]] * 3 + [[1, 0, 0]])
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-6)  # the node of a skinned mesh does not move it
    assert list(mesh.morph_targets) == ["blink", "target1"]
    assert mesh.morph_weights == (0.5, 0.0)
    np.testing.assert_allclose(
        mesh.posed(np.tile(np.eye(4), (3, 1, 1)), np.array([1.0, 0.0])), TRIANGLE + np.array([0, 0, 2])
    )
    assert mesh.uv is not None
    assert mesh.uv[1].tolist() == [2, 3]


@pytest.mark.shared_data
def test_a_character_of_meshopt_streams(shared_data: Path) -> None:
    """gltf-transform and the meshoptimizer of npm read the same positions, indices, joints, weights and matrices."""
    found = read_character(shared_data / "characters/valid_AIAN_F_2_Casual.glb")
    skin, wig = found.mesh("H_DDS_HighRes"), found.mesh("h_wig")
    assert (len(found.meshes), len(found.nodes), len(skin.vertices), len(skin.faces)) == (8, 92, 22040, 41792)
    assert (len(skin.morph_targets), skin.materials, wig.materials) == (65, ("_Body",), ("Hair",))
    np.testing.assert_allclose(skin.vertices.min(0), [-0.832, 0.0, -0.069], atol=1e-3)
    np.testing.assert_allclose(skin.vertices.max(0), [0.832, 1.718, 0.222], atol=1e-3)
    np.testing.assert_allclose(skin.weights.sum(1), 1)
    assert max(float(np.abs(target).max()) for target in skin.morph_targets.values()) < 0.1
    hips = found.nodes.names.index("Hips")
    np.testing.assert_allclose(found.nodes.scale[hips], 0.01, rtol=1e-6)
    # Neighbours on a body are close together; a wrong index or byte is not.
    edges = np.linalg.norm(skin.vertices[skin.faces] - skin.vertices[np.roll(skin.faces, 1, 1)], axis=2)
    assert edges.max() < 0.08
    # The head's joint moves the vertices round it.
    head = found.nodes.names.index("Head")
    rigid = (skin.weights * (skin.joints == head)).sum(1) > 0.9
    assert np.linalg.norm(skin.vertices[rigid] - found.nodes.world[head, :3, 3], axis=1).max() < 0.25
    assert found.animations == ()


def test_compressed_indices_and_their_contradictions(tmp_path: Path) -> None:
    file = GltfFile()
    corners = [0, 2, 1, 3, 1, 2, 0, 1, 3]
    found = read(mesh_file(file=file, indices=compressed(file, np.uint16(corners), "TRIANGLES")), tmp_path)
    assert found.meshes[0].faces.flatten().tolist() == corners
    extension = file.document["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]
    good = dict(extension)
    for change, message in (
        ({"count": 2**30}, "as it is decompressed, found 18"),
        ({"byteLength": 2**31 - 1}, "bytes in its buffer, found"),
        ({"byteLength": 20}, "a meshopt stream, found compressed bytes that end early"),
        ({"byteLength": 12}, "at least 20 compressed bytes, found 12"),
        ({"mode": "LINES"}, "at least 35 compressed bytes|mode 'LINES'"),
        ({"mode": "ATTRIBUTES", "byteStride": 4, "count": 4}, "at least 37 compressed bytes, found 32"),
        ({"buffer": 1}, "a uri, or to be the binary part"),
        ({"byteStride": 1}, "byteStride from 2 to 256"),
    ):
        extension |= good | change
        with pytest.raises(InputError, match=message):
            read(file, tmp_path)


def changed(path: str, value: Any) -> Callable[[GltfFile], None]:
    """Replaces a value of a document, or adds it."""

    def change(file: GltfFile) -> None:
        *above, last = [int(step) if step.isdecimal() else step for step in path.split("/")]
        place: Any = file.document
        for step in above:
            place = place[step]
        place[last] = value

    return change


ATTRIBUTES = "meshes/0/primitives/0/attributes"
REFUSED = {
    "version": ("asset/version", "1.0", "version 2.0, found '1.0'"),
    "asset": ("asset", [], "an object as asset"),
    "Draco": ("extensionsRequired", ["KHR_draco_mesh_compression"], "without Draco"),
    "unknown extension": ("extensionsRequired", ["EXT_\nx"], "found EXT_ x"),
    "extensions": ("extensionsRequired", [1], "names in extensionsRequired"),
    "huge count": ("accessors/0/count", 2**31 - 1, "bytes in its buffer view"),
    "negative count": ("accessors/0/count", -1, "count from 1"),
    "no count": ("accessors/0/count", None, "found none"),
    "fraction": ("accessors/0/count", 1.5, "found 1.5"),
    "component": ("accessors/0/componentType", 5124, "a componentType of"),
    "kind": ("accessors/0/type", "VEC9", "type VEC3, found 'VEC9'"),
    "offset of an accessor": ("accessors/0/byteOffset", 2**30, "bytes in its buffer view"),
    "offset of a view": ("bufferViews/0/byteOffset", 2**30, "bytes in its buffer, found"),
    "negative offset": ("bufferViews/0/byteOffset", -4, "byteOffset from 0"),
    "length of a view": ("bufferViews/0/byteLength", 2**31 - 1, "bytes in its buffer, found"),
    "stride": ("bufferViews/0/byteStride", 4, "elements of at most 4 bytes"),
    "no such view": ("accessors/0/bufferView", 99, "bufferView from 0 to"),
    "no such buffer": ("bufferViews/0/buffer", 3, "buffer from 0 to 0"),
    "no such accessor": (f"{ATTRIBUTES}/POSITION", 99, "POSITION from 0 to"),
    "a thousand digits": (f"{ATTRIBUTES}/POSITION", 10**40, "a number beyond any count"),
    "no positions": (ATTRIBUTES, {}, "POSITION from 0 to"),
    "no weights": (ATTRIBUTES, {"POSITION": 0}, "JOINTS_0 and WEIGHTS_0"),
    "rows": (f"{ATTRIBUTES}/WEIGHTS_0", 4, "type VEC4, found 'MAT4'"),
    "node below itself": ("nodes/2/children", [0], "nodes below themselves"),
    "two parents": ("nodes/0/children", [1, 2], "a node with one parent"),
    "children": ("nodes/0/children", "1", "children: indices below"),
    "rotation": ("nodes/0/rotation", [0, 0, 0, 0], "a rotation of length 1"),
    "three numbers": ("nodes/0/translation", [0, 0], "3 numbers within"),
    "far": ("nodes/0/translation", [0, 0, 1e30], "numbers within 1e"),
    "text as number": ("nodes/0/scale", ["1", 1, 1], "numbers within"),
    "shear": ("nodes/0/matrix", [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "one that shears"),
    "flat": ("nodes/0/matrix", [0] * 16, "without an inverse"),
    "no nodes": ("nodes", [], "1 to"),
    "node": ("nodes/0", 3, "an object as nodes"),
    "mesh": ("nodes/25/mesh", 1, "mesh from 0 to 0"),
    "skin": ("nodes/25/skin", 1, "skin from 0 to 0"),
    "joint": ("skins/0/joints", [99], "indices below"),
    "no joints": ("skins/0/joints", [], "joints, found none"),
    "too few joints": ("skins/0/joints", [1], "indices below 1"),
    "matrices": ("accessors/4/count", 3, "inverse bind matrices, found 3"),
    "meshes": ("meshes", {}, "a list of meshes"),
    "name": ("nodes/0/name", 7, "a text as name"),
    "targets": ("meshes/0/weights", [1], "weights of morph targets"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_contradictions_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path, value, message = REFUSED[name]
    file = figure(np.tile(np.eye(3), (2, len(NAMES), 1, 1)))
    changed(path, value)(file)
    with pytest.raises(InputError, match=message) as refusal:
        read(file, tmp_path)
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 400


def test_numbers_that_are_none(tmp_path: Path) -> None:
    file = mesh_file(mode=5)
    file.binary[:4] = struct.pack("<f", np.nan)
    with pytest.raises(InputError, match="numbers within 1e"):
        read(file, tmp_path)
    file = figure()
    file.document["nodes"][0]["scale"] = [np.nan, 1, 1]
    with pytest.raises(InputError, match="NaN, which JSON does not have"):
        read(file, tmp_path)
    deep = GltfFile()
    for index in range(60):
        deep.add("nodes", scale=[1e9] * 3, **({"children": [index + 1]} if index < 59 else {}))
    with pytest.raises(InputError, match="within 1e300"):
        read(deep, tmp_path)


def test_what_is_no_gltf(tmp_path: Path) -> None:
    good = figure().glb()
    for content, message in (
        (b"", "glTF 2.0"),
        (good[:200], "bytes to hold its chunk"),
        (good[:6], "bytes to hold its header"),
        (b"glTF" + struct.pack("<II", 1, 20) + bytes(20), "version 1"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 0, 7), "JSON first"),
        (b"\xff\xfe", "glTF 2.0"),
        (b"[]", "JSON that is no object"),
        (b"[" * 100_000, "glTF 2.0"),
        (b"HIERARCHY\nROOT Hips\n", "found neither its header nor JSON"),
    ):
        with pytest.raises(InputError, match=message):
            read(content, tmp_path)
    with pytest.raises(InputError, match=r"suffix '\.obj'"):
        read_character(tmp_path / "file.obj")


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("../secret.bin", "a file in the folder"),
        ("/etc/passwd", "a file in the folder"),
        ("https://example.com/a.bin", "a file in the folder"),
        ("missing.bin", "no such file"),
        ("short.bin", "bytes, found 3"),
        (".", "a file in the folder|a folder"),
        ("data:text/plain,abc", "data in base64"),
        ("data:;base64,%%", "data in base64"),
    ],
)
def test_buffers_elsewhere(uri: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "short.bin").write_bytes(b"abc")
    with pytest.raises(InputError, match=message):
        read(figure().gltf(uri), tmp_path, ".gltf")


def test_json_is_read_with_a_byte_order_mark(tmp_path: Path) -> None:
    assert json.loads(figure().gltf())["asset"]
    assert read(b"\xef\xbb\xbf" + figure().gltf(), tmp_path, ".gltf").meshes


def test_attributes_of_users_are_read(tmp_path: Path) -> None:
    """Scalars whose names begin with an underscore; what else there is, and what is damaged, is left out."""
    file = GltfFile()
    attributes = {
        "POSITION": file.accessor(TRIANGLE),
        "_SCALP": file.accessor(np.uint8([0, 255, 255, 0]), normalized=True),
        "_WEIGHT": file.accessor(np.float32([0, 0.25, 0.5, 7])),
        "_TINT": file.accessor(TRIANGLE),
        "_SHORT": file.accessor(np.float32([1, 1])),
        "_ID": file.accessor(np.float32([np.nan, 0, 0, 0])),
    }
    file.add("meshes", primitives=[{"attributes": attributes}, {"attributes": {"POSITION": attributes["POSITION"]}}])
    file.document["meshes"][0]["primitives"][0]["indices"] = file.accessor(np.uint8([0, 1, 2]))
    file.document["meshes"][0]["primitives"][1]["indices"] = file.accessor(np.uint8([1, 2, 3]))
    file.add("nodes", name="Thing", mesh=0)
    (mesh,) = read(file, tmp_path).meshes
    assert list(mesh.attributes) == ["_SCALP", "_WEIGHT"]
    np.testing.assert_allclose(mesh.attributes["_SCALP"], [0, 1, 1, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(mesh.attributes["_WEIGHT"], [0, 0.25, 0.5, 7, 0, 0, 0, 0])
