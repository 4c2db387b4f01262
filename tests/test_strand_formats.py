"""Strands in Alembic, PLY and arrays of numpy, against the same strands in other formats and against other readers."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.extras import is_installed
from quaffure.geometry import Surface
from quaffure.hair import Strands, register_groom
from quaffure.io import read_head
from quaffure.io.read_strands import read_strands

HAS_ALEMBIC = is_installed("alembic3d")
needs_alembic = pytest.mark.skipif(not HAS_ALEMBIC, reason="no alembic3d: the extra alembic is not installed")
POINTS = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 1, 3], [1, 2, 4], [1, 2, 5], [2, 2, 6]], dtype=float)


def assert_same(found: Strands, expected: Strands, atol: float = 0.0) -> None:
    assert found.counts.tolist() == expected.counts.tolist()
    np.testing.assert_allclose(found.points, expected.points, atol=atol, rtol=0)


@pytest.mark.shared_data
@pytest.mark.parametrize(
    "name", [pytest.param("Bangs_100.abc", marks=needs_alembic), "Bangs_100_ascii.ply", "Bangs_100.bin"]
)
def test_the_same_strands_in_every_format(name: str, shared_data: Path) -> None:
    expected = read_strands(shared_data / "formats/Bangs_100.data")
    assert (len(expected), len(expected.points)) == (100, 1165)
    assert_same(read_strands(shared_data / "formats" / name), expected, 1e-4 if "ascii" in name else 0.0)


@pytest.mark.shared_data
def test_units_and_axes_of_a_scan_are_understood(shared_data: Path, body: BodyModel, surface: Surface) -> None:
    """A scan of a lying head: millimetres, the crown at +x and the face at -y."""
    _, report = register_groom(read_strands(shared_data / "formats/Bangs_100.data"), body, "bangs")
    assert (report.unit, report.up_axis, report.kept) == ("mm", "+x", 100)
    # A few roots of a head of another form tell the pitch to some degrees.
    face, crown = report.rotation @ [0, -1, 0], report.rotation @ [1, 0, 0]
    assert face @ [0, -1, 0] > np.cos(np.radians(20))
    assert crown @ [0, 0, 1] > np.cos(np.radians(20))


@pytest.mark.shared_data
def test_a_head_as_ply(shared_data: Path) -> None:
    head = read_head(shared_data / "formats/Bangs_head.ply")
    expected = trimesh.load(shared_data / "formats/Bangs_head.ply", process=False)
    np.testing.assert_allclose(head.vertices, expected.vertices)
    np.testing.assert_array_equal(head.faces, expected.faces)


@pytest.mark.shared_data
def test_curls_as_binary_ply(shared_data: Path) -> None:
    """Positions as trimesh reads them; segments of each strand as their file counts them."""
    strands = read_strands(shared_data / "formats/Curly_100.ply")
    assert (len(strands), len(strands.points)) == (100, 2528)
    vertices = np.asarray(trimesh.load(shared_data / "formats/Curly_100.ply", process=False).vertices)
    np.testing.assert_allclose(strands.points, vertices, atol=1e-4)
    content = (shared_data / "formats/Curly_100.ply").read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n") + 2528 * 15
    assert strands.counts.tolist() == (np.frombuffer(content, "<u2", 100, start) + 1).tolist()


@pytest.mark.shared_data
def test_a_reconstruction_as_npy(shared_data: Path, body: BodyModel, surface: Surface) -> None:
    strands = read_strands(shared_data / "formats/base_0_idx_17453.npy")
    assert strands.counts.tolist() == [32] * 156
    expected = np.load(shared_data / "formats/base_0_idx_17453.npy")
    np.testing.assert_array_equal(strands.points.reshape(156, 32, 3), expected)
    _, report = register_groom(strands, body, "base")
    assert (report.unit, report.up_axis, report.kept) == ("m", "+y", 156)


def ply(header: str, content: bytes, form: str = "binary_little_endian") -> bytes:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    vertices = f"element vertex {len(POINTS)}\n{axes}"
    return f"ply\nformat {form} 1.0\n{vertices}{header}end_header\n".encode() + content


PLYS = {
    "segments": ("element strand 2\nproperty ushort nsegs\n", np.array([2, 3], "u2")),
    "vertices": ("element strands 2\nproperty int nverts\n", np.array([3, 4], "i4")),
    "edges": (
        "element edge 5\nproperty int vertex1\nproperty int vertex2\n",
        np.array([[0, 1], [1, 2], [3, 4], [4, 5], [5, 6]], "i4"),
    ),
    "edges in any order": (
        "element edge 5\nproperty int vertex1\nproperty int vertex2\n",
        np.array([[5, 4], [1, 0], [6, 5], [1, 2], [3, 4]], "i4"),
    ),
}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("name", PLYS)
def test_strands_of_a_ply_by_counts_and_by_edges(name: str, order: str, tmp_path: Path) -> None:
    header, numbers = PLYS[name]
    content = POINTS.astype(f"{order}f4").tobytes() + numbers.astype(numbers.dtype.newbyteorder(order)).tobytes()
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    (tmp_path / "hair.ply").write_bytes(ply(header, content, form))
    strands = read_strands(tmp_path / "hair.ply")
    assert strands.counts.tolist() == [3, 4]
    np.testing.assert_array_equal(strands.points, POINTS)


def test_edges_that_jump_between_vertices_make_chains(tmp_path: Path) -> None:
    edges = np.array([[0, 2], [2, 4], [1, 3]], "<i4")
    header = "element edge 3\nproperty int vertex1\nproperty int vertex2\n"
    (tmp_path / "hair.ply").write_bytes(ply(header, POINTS.astype("<f4").tobytes() + edges.tobytes()))
    strands = read_strands(tmp_path / "hair.ply")
    assert strands.counts.tolist() == [3, 2]
    np.testing.assert_array_equal(strands.points, POINTS[[0, 2, 4, 1, 3]])


@pytest.mark.parametrize(
    ("header", "numbers", "message"),
    [
        ("element strand 2\nproperty ushort nsegs\n", np.array([2, 9], "<u2"), "13 points for its 2 strands, found 7"),
        ("element strand 9\nproperty ushort nsegs\n", np.array([2, 3], "<u2"), "9 rows of strand, found 4 bytes left"),
        ("element edge 1\nproperty int vertex1\nproperty int vertex2\n", np.array([0, 7], "<i4"), "indices of its 7"),
        (
            "element edge 3\nproperty int vertex1\nproperty int vertex2\n",
            np.array([0, 1, 0, 2, 0, 3], "<i4"),
            "a vertex of three edges",
        ),
        ("element face 1\nproperty list uchar int vertex_indices\n", np.array([0], "u1"), "expected strands"),
        ("element strand 1\nproperty word nsegs\n", np.array([2], "<u2"), "property lines, found 'property word"),
    ],
)
def test_broken_plys_are_refused(header: str, numbers: np.ndarray, message: str, tmp_path: Path) -> None:
    (tmp_path / "hair.ply").write_bytes(ply(header, POINTS.astype("<f4").tobytes() + numbers.tobytes()))
    with pytest.raises(InputError, match=message):
        read_strands(tmp_path / "hair.ply")


def test_arrays_with_roots_and_with_padding(tmp_path: Path) -> None:
    strands = np.stack([POINTS[:4], POINTS[3:]])
    relative, roots = strands - strands[:, :1], strands[:, 0]
    np.save(tmp_path / "hair.npy", strands)
    np.savez(tmp_path / "own_name.npz", hair=strands, faces=np.zeros((4, 3)), tool=np.array([{}], dtype=object))
    np.savez(tmp_path / "relative.npz", strands=relative, roots=roots)
    np.savez(tmp_path / "absolute.npz", strands=strands, roots=roots)
    for path in tmp_path.iterdir():
        np.testing.assert_array_equal(read_strands(path).points.reshape(2, 4, 3), strands, err_msg=path.name)
    padded = strands.copy()
    padded[1, 2:] = np.nan
    np.save(tmp_path / "padded.npy", padded)
    assert read_strands(tmp_path / "padded.npy").counts.tolist() == [4, 2]
    padded[0, 1] = np.nan
    np.save(tmp_path / "holed.npy", padded)
    with pytest.raises(InputError, match="NaN, infinity or more in 1"):
        read_strands(tmp_path / "holed.npy")
    np.savez(tmp_path / "more_roots.npz", strands=relative, roots=POINTS)
    with pytest.raises(InputError, match=r"finite roots \[2, 3\]"):
        read_strands(tmp_path / "more_roots.npz")
    np.save(tmp_path / "pickled.npy", np.array([{}], dtype=object))
    (tmp_path / "zip.npy").write_bytes((tmp_path / "own_name.npz").read_bytes())
    np.save(tmp_path / "flat.npy", POINTS)
    for name in ("pickled", "zip", "flat"):
        with pytest.raises(InputError, match=r"\[S,N,3\]"):
            read_strands(tmp_path / f"{name}.npy")


@needs_alembic
def test_alembic_bases_transforms_groups_and_guides(tmp_path: Path) -> None:
    from tests.alembic_curves import write_curves

    path = tmp_path / "hair.abc"
    shifted = POINTS + np.array([10, 0, 0])
    write_curves(
        path,
        {
            "linear": {"points": POINTS, "counts": [3, 4], "move": (0, 0, 5)},
            "beziers": {"points": shifted, "counts": [7], "basis": "kBezierBasis", "frames": 3},
            "hidden": {"points": POINTS, "counts": [7], "hidden": True},
            "guides": {"points": POINTS, "counts": [3, 4], "guide": [1, 1]},
        },
    )
    strands = read_strands(path)
    assert strands.counts.tolist() == [3, 4, 17]
    np.testing.assert_allclose(strands.points[:7], POINTS + np.array([0, 0, 5]), atol=1e-6)
    # Of a curve that moves, the first frame.
    np.testing.assert_allclose(strands.points[7:][[0, 8, 16]], shifted[[0, 3, 6]], atol=1e-6)
    middle = (shifted[0] + 3 * shifted[1] + 3 * shifted[2] + shifted[3]) / 8
    np.testing.assert_allclose(strands.points[11], middle, atol=1e-6)
    write_curves(path, {"mixed": {"points": POINTS, "counts": [3, 4], "guide": [1, 0]}})
    np.testing.assert_allclose(read_strands(path).points, POINTS[3:], atol=1e-6)
    write_curves(path, {"guides": {"points": POINTS, "counts": [3, 4], "guide": [1, 1]}})
    assert len(read_strands(path)) == 2
    write_curves(path, {"b-splines": {"points": POINTS, "counts": [7], "basis": "kBsplineBasis"}})
    np.testing.assert_allclose(read_strands(path).points[0], (POINTS[0] + 4 * POINTS[1] + POINTS[2]) / 6, atol=1e-6)


@needs_alembic
def test_files_that_are_no_alembic_curves_are_refused(tmp_path: Path) -> None:
    from tests.alembic_curves import write_curves

    path = tmp_path / "hair.abc"
    path.write_bytes(b"Ogawa" + bytes(200))
    with pytest.raises(InputError, match="an Alembic file"):
        read_strands(path)
    write_curves(path, {})
    with pytest.raises(InputError, match="no strands: no curves"):
        read_strands(path)


@pytest.mark.skipif(HAS_ALEMBIC, reason="alembic3d is installed")
def test_without_alembic_the_extra_is_named(tmp_path: Path) -> None:
    (tmp_path / "hair.abc").write_bytes(b"Ogawa")
    with pytest.raises(InputError, match=r"pip install 'quaffure\[alembic\]'"):
        read_strands(tmp_path / "hair.abc")
