"""Small valid files of every format that is read, made on the fly."""

import json
from functools import cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from quaffure import HairMaterial
from quaffure.body import joint_map_text, load_body
from quaffure.body.joint_map import bundled_joint_map
from quaffure.extras import is_installed
from quaffure.hair import DrapeSequence, Groom, PlacedStrands, StrandAttributes
from quaffure.io import write_drape, write_groom, write_usd
from quaffure.io.read_character import read_character
from quaffure.model import NetworkConfig, build_network, save_network
from tests.fbx_characters import FbxForm, fbx_of
from tests.fuzzing.run_seeds import checkpoint, run_seeds, written
from tests.fuzzing.written_seeds import ply_heads, ply_of_properties, whole_groom, write_strands
from tests.gltf_files import NAMES as RIG_NAMES
from tests.gltf_files import GltfFile, figure
from tests.meshopt_streams import compressed
from tests.test_fbx_damaged import whole as fbx_of_parts
from tests.test_groom_files import EVEN, GOOD, RAGGED, npz_bytes, ragged_npz
from tests.test_retarget import CHANNELS, NAMES, SKELETON, random_angles

CHARACTERS = (
    b"groom,motion,frames,out,shape,stiffness,seed\n"
    b"bob,walk,0:60:2,out/anna.usd,1 0 0 0 0 0 0 0 0 0,1,\n"
    b'long_wavy,dance.bvh,,"out/berta, again.abc",,0.5,7\n'
)
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


@cache
def seeds() -> dict[str, tuple[str, tuple[bytes, ...]]]:
    """By format, the suffix and files that its reader takes."""
    body = load_body()
    whole = whole_groom()
    groom = whole.select(torch.arange(0, len(whole), 4))
    poses = np.random.default_rng(0).normal(scale=0.1, size=(3, 165))
    network = build_network(NetworkConfig(texel_channels=4, strand_width=8))
    drape = _drape()
    foreign = npz_bytes(strands=100 * whole.rest_strands.numpy())

    def usd(suffix: str) -> bytes:
        return written(lambda path: write_usd(path, drape), suffix)

    return {
        **{kind: (f".{kind}", (*_good(f".{kind}"), _ours(f".{kind}"))) for kind in ("hair", "data", "bin")},
        "tfx": (".tfx", _good(".tfx")),
        "npz strands": (".npz", (ragged_npz(RAGGED), npz_bytes(strands=np.float32(EVEN)), _rooted())),
        "npy": (".npy", (_npy(np.float32(EVEN)), _npy(np.float32([CUBE[:4], [*CUBE[4:7], [np.nan] * 3]])))),
        "ply": (".ply", (*_plys(), ply_of_properties(), _ours(".ply"))),
        "ply head": (".ply", ply_heads()),
        **dict.fromkeys(("npz registered", "npz aligned"), (".npz", (foreign,))),
        "npz groom": (".npz", _grooms(groom)),
        "npz drape": (".npz", (written(lambda path: write_drape(path, drape), ".npz"),)),
        "npz body": (".npz", _bodies()),
        "npz shape": (".npz", (npz_bytes(body_shape=np.linspace(-1, 1, 10)),)),
        "npz motion": (".npz", (npz_bytes(body_pose=np.float32(poses[:, :81]), fps=np.float32(30)),)),
        "npz amass": (".npz", (npz_bytes(poses=poses, trans=poses[:, :3], mocap_framerate=120.0),)),
        "bvh": (".bvh", (_bvh(),)),
        "toml joints": (".toml", (joint_map_text(bundled_joint_map("smpl")).encode(),)),
        "glb": (".glb", (_figure().glb(), _compressed())),
        "gltf": (".gltf", (_indented(_figure().gltf()),)),
        "fbx": (".fbx", _fbx_figures()),
        "fbx parts": (".fbx", (fbx_of_parts().content(7400), fbx_of_parts().content(7700, is_deflated=True))),
        "obj": (".obj", (_obj(),)),
        "csv": (".csv", (b"0.5,-1,0,0,0,2e-1,0,0,0,0\n", b"0 1 0 1 0 1 0 1 0 1")),
        "csv characters": (".csv", (CHARACTERS,)),
        "safetensors": (
            ".safetensors",
            (written(lambda path: save_network(path, network, HairMaterial(), {"step": "1"}), ".safetensors"),),
        ),
        "usda": (".usda", (usd(".usda"),)),
        "usdc": (".usdc", (usd(".usdc"),)),
        "usdz": (".usdz", (_usdz(usd(".usdc")),)),
        "checkpoint": (".pt", (checkpoint(),)),
        **run_seeds(groom, body),
        **({"abc": (".abc", (_alembic(), _ours(".abc")))} if is_installed("alembic3d") else {}),
    }


def _good(suffix: str) -> tuple[bytes, ...]:
    return tuple(content for kind, content, _ in GOOD.values() if kind == suffix)


def _ours(suffix: str) -> bytes:
    return written(write_strands, suffix)


def _rooted() -> bytes:
    """Strands that begin at the origin, with their roots, and NaN after a tip."""
    strands = np.float32([CUBE[:4], CUBE[4:] - CUBE[4]])
    strands[1, 3] = np.nan
    return npz_bytes(strands=strands, roots=np.float32(CUBE[[1, 6]]))


def _drape() -> DrapeSequence:
    """Three strands in two frames, on a tetrahedron."""
    strands = np.float32(0.01 * np.array(EVEN))
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return DrapeSequence(
        strands=np.stack([strands, strands]),
        posed=np.stack([strands, strands]),
        rest_lengths=np.linalg.norm(np.diff(strands, axis=1), axis=-1),
        body_vertices=np.stack([corners, corners]),
        body_faces=np.int32([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        body_pose=np.zeros((2, 81), np.float32),
        body_shape=np.zeros(10, np.float32),
        fps=30.0,
        meta={"groom": "seed", "draper": "none", "milliseconds": 1.0},
    )


def _grooms(groom: Groom) -> tuple[bytes, bytes]:
    """Without and with strands that it was registered from."""
    counts, points = np.array([2, 3]), np.float32(CUBE[:5])
    said = {"width": points[:, 0], "colour": points, "identifier": counts, "group": counts - 3}
    said |= {"root_uv": points[:2, :2], "group_names": np.array(["bun"])}
    source = PlacedStrands(0.1 * points, counts, counts > 2, counts > 1, StrandAttributes.of_arrays(said))
    plain = written(lambda path: write_groom(path, groom), ".npz")
    return plain, written(lambda path: write_groom(path, groom, source), ".npz")


def _bodies() -> tuple[bytes, bytes]:
    """The shipped one, and it as if it had been imported from a character."""
    shipped = files("quaffure").joinpath("assets", "body.npz").read_bytes()
    with np.load(BytesIO(shipped)) as arrays:
        origin = {
            "file_from_body_rotation": np.eye(3),
            "file_from_body_scale": np.array(100.0),
            "file_from_body_translation": np.zeros(3),
            "file_name": np.array("figure.glb"),
            "file_digest": np.array("0" * 16),
            "file_joint_nodes": np.arange(27).astype(str),
        }
        return shipped, npz_bytes(**arrays, **origin)


def _bvh() -> bytes:
    lines = ["HIERARCHY"]

    def add(name: str, depth: int) -> None:
        indent = "  " * depth
        offset = next(offset for joint, _, offset in SKELETON if joint == name)
        children = [joint for joint, parent, _ in SKELETON if parent == name]
        lines.extend([f"{indent}{'JOINT' if depth else 'ROOT'} {name}", indent + "{"])
        lines.append(f"{indent}  OFFSET {' '.join(map(str, offset))}")
        lines.append(f"{indent}  CHANNELS {len(CHANNELS)} {' '.join(CHANNELS)}")
        for child in children:
            add(child, depth + 1)
        if not children:
            lines.extend([f"{indent}  End Site", indent + "  {", f"{indent}    OFFSET 0 1 0", indent + "  }"])
        lines.append(indent + "}")

    add(SKELETON[0][0], 0)
    angles = random_angles(3).reshape(3, len(NAMES) * 3)
    rows = [" ".join(f"{angle:.3f}" for angle in row) for row in angles]
    return "\n".join([*lines, "MOTION", "Frames: 3", "Frame Time: 0.033333", *rows, ""]).encode()


def _figure() -> GltfFile:
    """A figure with a mesh, an animation and morph targets."""
    turned = Rotation.from_euler("x", [[0.0], [0.3], [0.1]]).as_matrix()
    file = figure(np.repeat(turned[:, None], len(RIG_NAMES), axis=1), np.full((3, 3), 90.0))
    primitive = file.document["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}]
    times, weights = np.array([0, 0.1]), np.array([0, 1, 0] * 2)
    file.animation("smile", [(len(RIG_NAMES) + 1, "weights", "CUBICSPLINE", times, weights.reshape(-1, 1))])
    return file


def _compressed() -> bytes:
    """A mesh of meshopt streams."""
    file = GltfFile()
    corners = compressed(file, np.uint16([0, 2, 1, 3, 1, 2]), "TRIANGLES")
    primitive = {"attributes": {"POSITION": compressed(file, np.float32(CUBE[:4]))}, "indices": corners}
    file.add("meshes", primitives=[primitive])
    file.add("nodes", mesh=0)
    return file.glb()


def _fbx_figures() -> tuple[bytes, bytes]:
    """A figure that moves, in records of both widths."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "figure.glb"
        path.write_bytes(_figure().glb())
        character = read_character(path)
    turned, plain = fbx_of(character, FbxForm(is_z_up=True, is_turned=True)), fbx_of(character)
    return turned.content(7400), plain.content(7500, is_deflated=True)


def _indented(document: bytes) -> bytes:
    return json.dumps(json.loads(document), indent=1).encode()


def _obj() -> bytes:
    faces = ("1 2 4 3", "5 7 8 6", "1/1 5/1 6/1", "1/1/1 6/1/1 2/1/1", "3 4 8", "-6 -1 -2", "1 3 7 5", "2 6 8 4")
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE] + ["vt 0 0", "vn 0 0 1", "o head"] + [f"f {face}" for face in faces]
    return "\n".join(lines).encode()


def _npy(array: np.ndarray) -> bytes:
    return written(lambda path: np.save(path, array), ".npy")


def _plys() -> tuple[bytes, ...]:
    """The same two strands with counts as text, with edges in big-endian, and with lists in little-endian order."""
    vertices = np.arange(15, dtype=np.float32).reshape(5, 3)
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    rows = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in vertices)
    strands = "element strand 2\nproperty ushort nsegs\nend_header\n"
    counts = f"ply\nformat ascii 1.0\nelement vertex 5\n{axes}{strands}{rows}1\n2\n"
    edge = "element edge 3\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    edges = f"ply\nformat binary_big_endian 1.0\nelement vertex 5\n{axes}{edge}".encode()
    edges += vertices.astype(">f4").tobytes() + np.array([[0, 1], [2, 3], [4, 3]], ">i4").tobytes()
    polyline = "element polyline 2\nproperty list uchar int vertex_indices\nend_header\n"
    lists = f"ply\nformat binary_little_endian 1.0\nelement vertex 5\n{axes}{polyline}".encode() + vertices.tobytes()
    lists += b"".join(bytes([len(row)]) + np.array(row, "<i4").tobytes() for row in ([0, 1], [2, 3, 4]))
    return counts.encode(), edges, lists


def _usdz(stage: bytes) -> bytes:
    from pxr import UsdUtils

    with TemporaryDirectory() as folder:
        path = Path(folder) / "seed.usdc"
        path.write_bytes(stage)
        assert UsdUtils.CreateNewUsdzPackage(str(path), f"{folder}/seed.usdz")
        return (Path(folder) / "seed.usdz").read_bytes()


def _alembic() -> bytes:
    from tests.alembic_curves import write_curves

    curves = {"points": CUBE, "counts": [3, 5], "guide": [0, 0]}
    bezier = {"points": CUBE, "counts": [4, 4], "basis": "kBezierBasis", "integers": {"groom_id": [7, 8]}}
    objects = {"hair": curves, "bang": curves | {"basis": "kBsplineBasis"}, "bun": bezier}
    return written(lambda path: write_curves(path, objects), ".abc")
