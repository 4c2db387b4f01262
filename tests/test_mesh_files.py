"""Strands as meshes (.glb), as vertices with edges (.ply) and as polylines (.hair)."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.hair import ExportClip, ExportSettings
from quaffure.io import write_glb, write_hair, write_ply
from quaffure.io.glb_asset import in_gltf
from quaffure.io.read_strands import read_strands
from quaffure.io.strand_mesh import strand_mesh_faces, strand_mesh_normals, strand_mesh_positions
from tests.export_clips import FRAMES, export_clip
from tests.synthetic_drape import drape, patch_of_strands
from tests.training_runs import tiny_groom

WIDTH = np.array([2e-3, 1e-3], np.float32)


def read_glb(path: Path) -> tuple[dict, bytes]:
    content = path.read_bytes()
    magic, two, length, size, kind = struct.unpack_from("<4sIII4s", content)
    assert (magic, two, length, kind) == (b"glTF", 2, len(content), b"JSON")
    document = json.loads(content[20 : 20 + size])
    binary_size, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert kind == b"BIN\0"
    assert size % 4 == binary_size % 4 == 0
    assert document["buffers"] == [{"byteLength": binary_size}]
    return document, content[28 + size :]


def array_of(document: dict, binary: bytes, accessor: int) -> np.ndarray:
    about = document["accessors"][accessor]
    view = document["bufferViews"][about["bufferView"]]
    assert view["byteOffset"] % 4 == 0
    dtype = {5126: "<f4", 5125: "<u4"}[about["componentType"]]
    values = np.frombuffer(binary, dtype, view["byteLength"] // 4, view["byteOffset"])
    return values.reshape(about["count"], -1)


@pytest.mark.parametrize("mesh", ["ribbons", "tubes"])
def test_one_vertex_by_hand_and_frames_as_targets(tmp_path: Path, mesh: str) -> None:
    """(1, 2, 3) m is (1, 3, -2) in glTF; the target of a frame is the way there from the first one."""
    sequence = drape(patch_of_strands((0.0, 1.0, 0.0)))
    sequence.body_vertices[:, 5] = (1.0, 2.0, 3.0)
    sequence.body_vertices[2, 5] = (1.0, 2.0, 3.5)
    write_glb(tmp_path / "hair.glb", ExportClip(sequence, settings=ExportSettings(mesh=mesh)))
    document, binary = read_glb(tmp_path / "hair.glb")
    body, hair = (one["primitives"][0] for one in document["meshes"])
    assert array_of(document, binary, body["attributes"]["POSITION"])[5].tolist() == [1.0, 3.0, -2.0]
    targets = [array_of(document, binary, target["POSITION"])[5].tolist() for target in body["targets"]]
    assert targets == [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]
    moved = array_of(document, binary, hair["targets"][1]["POSITION"])
    np.testing.assert_allclose(moved, np.tile([2e-3, 0, 0], (len(moved), 1)), atol=1e-6)  # 1 mm a frame
    assert len(moved) == 150 * 8 * (2 if mesh == "ribbons" else 3)
    (animation,) = document["animations"]
    times, weights = (array_of(document, binary, animation["samplers"][0][end]) for end in ("input", "output"))
    np.testing.assert_allclose(times[:, 0], [0, 1 / 30, 2 / 30])
    assert weights.reshape(3, 2).tolist() == [[0, 0], [1, 0], [0, 1]]


@pytest.mark.parametrize(("profile", "around"), [("ribbons", 2), ("tubes", 3)])
def test_meshes_surround_their_strands(profile: str, around: int) -> None:
    """Upright strands on the top of a ball; vertices are half a width from the strand, normals point outwards."""
    strands = np.array([[[0.0, -1, 0], [0, -2, 0.1]], [[0.5, -1, 0], [0.5, -2, 0.1]], [[0.3, -1, 1], [0.3, -2, 1.1]]])
    points, counts = strands.reshape(-1, 3), np.full(3, 2)
    positions = strand_mesh_positions(points, counts, np.tile(WIDTH, 3), profile).reshape(3, 2, around, 3)
    np.testing.assert_allclose(positions.mean(axis=2), strands, atol=1e-6)
    radius = np.linalg.norm(positions - strands[:, :, None], axis=-1)
    np.testing.assert_allclose(radius, np.broadcast_to(WIDTH[None, :, None] / 2, radius.shape), atol=1e-7)
    normals = strand_mesh_normals(points, counts, profile).reshape(3, 2, around, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-6)
    tangent = np.gradient(strands, axis=1)[:, :, None]
    assert np.abs((normals * tangent).sum(-1)).max() < 1e-6
    if profile == "ribbons":
        assert ((normals * (strands - strands[:, 0].mean(0))[:, :, None]).sum(-1) > 0).all()
    faces = strand_mesh_faces(counts, profile)
    assert faces.shape == (3 * 2 * (1 if profile == "ribbons" else 3), 3)
    first, second, third = positions.reshape(-1, 3)[faces].transpose(1, 0, 2)
    facing = (np.cross(second - first, third - first) * normals.reshape(-1, 3)[faces].mean(1)).sum(-1)
    assert (facing > 0).all()


def test_meshes_of_strands_of_different_lengths_do_not_join() -> None:
    counts = np.array([2, 4, 3])
    points = np.cumsum(np.random.default_rng(0).normal(size=(9, 3)), axis=0)
    whole = strand_mesh_positions(points, counts, np.ones(9), "ribbons")
    normals, faces = strand_mesh_normals(points, counts, "ribbons"), strand_mesh_faces(counts, "ribbons")
    assert {(*np.repeat(np.arange(3), 2 * counts)[face],) for face in faces} == {(k, k, k) for k in range(3)}
    assert len(faces) == 2 * (9 - 3)
    along = whole.reshape(9, 2, 3)[2] - points[2]  # an inner strand's root: across its own edge alone
    assert np.abs(along @ (points[3] - points[2])).max() < 1e-6
    assert np.abs(normals.reshape(9, 2, 3)[2] @ (points[3] - points[2])).max() < 1e-6


def test_the_ends_of_a_clip_load_in_another_library(tmp_path: Path, body: BodyModel) -> None:
    trimesh = pytest.importorskip("trimesh")
    clip = export_clip(tiny_groom(body), body, 200, ExportSettings(points=6, every=3))
    write_glb(tmp_path / "hair.glb", clip)
    scene = trimesh.load(tmp_path / "hair.glb")
    assert {name: len(mesh.vertices) for name, mesh in scene.geometry.items()} == {
        "Body": len(body.rest_vertices),
        "Hair": 200 * 6 * 2,
    }
    document, _ = read_glb(tmp_path / "hair.glb")
    assert len(document["meshes"][1]["weights"]) == len(range(0, FRAMES, 3)) - 1


def test_a_skeleton_moves_body_and_hair_to_where_they_are(tmp_path: Path, body: BodyModel) -> None:
    """The file, posed by hand as glTF says, gives the body and the strands of the last frame."""
    clip = export_clip(tiny_groom(body), body, settings=ExportSettings(skinned=True))
    path = np.linspace((0, 0, 0), (0.3, -0.2, 0.1), FRAMES).astype(np.float32)
    clip = replace(clip, sequence=clip.sequence.moved(path))
    write_glb(tmp_path / "hair.glb", clip)
    document, binary = read_glb(tmp_path / "hair.glb")
    nodes = [{"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], **node} for node in document["nodes"]]
    (animation,) = document["animations"]
    for channel in animation["channels"]:
        sampler, target = animation["samplers"][channel["sampler"]], channel["target"]
        nodes[target["node"]][target["path"]] = array_of(document, binary, sampler["output"])[-1]
    world: dict[int, np.ndarray] = {}

    def place(node: int, parent: np.ndarray) -> None:
        own = np.eye(4)
        own[:3, :3] = Rotation.from_quat(nodes[node]["rotation"]).as_matrix()
        own[:3, 3] = nodes[node]["translation"]
        world[node] = parent @ own
        for child in nodes[node].get("children", []):
            place(child, world[node])

    for root in document["scenes"][0]["nodes"]:
        place(root, np.eye(4))
    skin, (body_mesh, hair_mesh) = document["skins"][0], (one["primitives"][0] for one in document["meshes"])
    inverse = array_of(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    bones = np.stack([world[node] for node in skin["joints"]]) @ inverse
    about, joints = document["accessors"], body_mesh["attributes"]["JOINTS_0"]
    view = document["bufferViews"][about[joints]["bufferView"]]
    index = np.frombuffer(binary, "<u2", 4 * about[joints]["count"], view["byteOffset"]).reshape(-1, 4)
    weights = array_of(document, binary, body_mesh["attributes"]["WEIGHTS_0"])
    rest = np.pad(array_of(document, binary, body_mesh["attributes"]["POSITION"]), ((0, 0), (0, 1)), constant_values=1)
    found = np.einsum("vk,vkij,vj->vi", weights, bones[index], rest)[:, :3]
    expected = in_gltf(clip.sequence.body_vertices[-1])
    assert np.linalg.norm(found - expected, axis=1).max() < 5e-3  # four of up to seven joints a vertex
    hair = array_of(document, binary, hair_mesh["attributes"]["POSITION"])
    hair = hair + array_of(document, binary, hair_mesh["targets"][-1]["POSITION"])
    (node,) = (index for index, one in enumerate(nodes) if one["name"] == "Hair")
    moved = hair @ world[node][:3, :3].T + world[node][:3, 3]
    middles = moved.reshape(-1, 2, 3).mean(axis=1)
    np.testing.assert_allclose(middles, in_gltf(clip.strands(FRAMES - 1).reshape(-1, 3)), atol=2e-6)
    with pytest.raises(InputError, match="--skinned"):
        write_glb(tmp_path / "none.glb", replace(clip, binding=None))


def test_ply_is_vertices_and_edges(tmp_path: Path) -> None:
    sequence = drape(patch_of_strands((0.0, 1.0, 0.0)), frames=1)
    write_ply(tmp_path / "hair.ply", ExportClip(sequence))
    header, _, content = (tmp_path / "hair.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex 1200\n" in header
    assert b"element edge 1050\n" in header
    kind = [("position", "<f4", 3), ("strand", "<i4"), ("width", "<f4"), ("colour", "u1", 3)]
    vertices = np.frombuffer(content, kind, 1200)
    assert vertices["colour"][0].tolist() == [108, 70, 44]  # sRGB of HAIR_COLOUR
    np.testing.assert_array_equal(vertices["width"].reshape(150, 8)[5], ExportClip(sequence).strand_width)
    edges = np.frombuffer(content, "<i4", 2 * 1050, vertices.nbytes).reshape(-1, 2)
    assert np.frombuffer(content, "<i4", offset=vertices.nbytes + edges.nbytes).tolist() == [7] * 150
    np.testing.assert_array_equal(vertices["position"].reshape(150, 8, 3), sequence.strands[0])
    np.testing.assert_array_equal(vertices["strand"], np.repeat(np.arange(150), 8))
    np.testing.assert_array_equal(edges.reshape(150, 7, 2)[1], np.stack([np.arange(8, 15), np.arange(9, 16)], 1))


def test_ply_loads_in_another_library(tmp_path: Path, body: BodyModel) -> None:
    trimesh = pytest.importorskip("trimesh")
    groom = tiny_groom(body)
    clip = replace(export_clip(groom, body, 200), settings=ExportSettings(every=FRAMES))
    write_ply(tmp_path / "hair.ply", clip)
    found = trimesh.load(tmp_path / "hair.ply")
    np.testing.assert_array_equal(np.asarray(found.vertices, np.float32), clip.points(0))
    assert len(found.entities) == 200
    tables = found.metadata["_ply_raw"]
    assert tables["strand"]["data"]["nsegs"].tolist() == [23] * 200
    assert tables["vertex"]["data"]["red"][0] == 108
    strands = read_strands(tmp_path / "hair.ply")
    np.testing.assert_array_equal(strands.counts, clip.counts)
    np.testing.assert_allclose(strands.attributes.width, clip.widths)
    np.testing.assert_allclose(strands.attributes.root_uv, clip.root_uv)


def test_a_written_hair_file_is_read(tmp_path: Path) -> None:
    sequence = drape(patch_of_strands((0.0, 1.0, 0.0)), frames=1)
    clip = ExportClip(sequence)
    write_hair(tmp_path / "drape.hair", clip)
    strands = read_strands(tmp_path / "drape.hair")
    assert strands.counts.tolist() == [8] * 150
    np.testing.assert_array_equal(strands.points.reshape(150, 8, 3), sequence.strands[0])
    thickness = np.frombuffer((tmp_path / "drape.hair").read_bytes(), "<f4", 1200, 128 + 12 * 1200)
    np.testing.assert_array_equal(thickness.reshape(150, 8)[3], clip.strand_width)


def test_the_command_refuses_many_frames_before_the_work(
    tmp_path: Path, tiny_groom_file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    options = ["drape", str(tiny_groom_file), "--draper", "posed", "--out", str(tmp_path / "hair.ply"), "--frames"]
    with pytest.raises(SystemExit):
        main([*options, "0:2"])
    assert "hair.ply: expected a drape of one frame" in capfd.readouterr().err
    main([*options, "1", "--strands", "20", "--points", "4", "--out", str(tmp_path / "hair.glb")])
    assert b"element vertex 80\n" in (tmp_path / "hair.ply").read_bytes()
    document, _ = read_glb(tmp_path / "hair.glb")
    assert "animations" not in document
    with pytest.raises(InputError, match="one frame"):
        write_ply(tmp_path / "hair.ply", ExportClip(drape(patch_of_strands((0.0, 1.0, 0.0)))))
