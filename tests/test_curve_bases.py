"""Curves of USD files as polylines: bases, wrap modes, NURBS, and which curves of a stage are read."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.hair import Strands, polyline_lengths, register_groom
from quaffure.hair.curve_bases import cubic_polylines, is_basis_valid, nurbs_polylines
from quaffure.io.read_strands import read_strands

pytest.importorskip("pxr")
from pxr import Gf, Usd, UsdGeom, Vt

CONTROL = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 2], [1, 1, 3], [0, 1, 4], [0, 0, 5], [1, 0, 6]], dtype=float)


def cubic(basis: str, wrap: str, count: int = 7) -> np.ndarray:
    points, counts = cubic_polylines(np.tile(CONTROL[:count], (2, 1)), np.array([count, count]), basis, wrap)
    assert counts[0] == counts[1] == len(points) / 2
    return points[: counts[0]]


def test_beziers_pass_every_third_point_and_are_theirs_at_the_middle() -> None:
    line = cubic("bezier", "nonperiodic")
    np.testing.assert_allclose(line[[0, 8, 16]], CONTROL[[0, 3, 6]])
    np.testing.assert_allclose(line[4], (CONTROL[0] + 3 * CONTROL[1] + 3 * CONTROL[2] + CONTROL[3]) / 8)


def test_b_splines_are_those_of_scipy() -> None:
    line = cubic("bspline", "nonperiodic")
    at = np.linspace(3, 7, len(line))
    np.testing.assert_allclose(line, BSpline(np.arange(11.0), CONTROL, 3)(at), atol=1e-12)


@pytest.mark.parametrize("basis", ["bspline", "catmullRom"])
def test_pinned_curves_reach_their_ends(basis: str) -> None:
    np.testing.assert_allclose(cubic(basis, "pinned")[[0, -1]], CONTROL[[0, -1]], atol=1e-12)


def test_catmull_rom_passes_its_inner_points() -> None:
    line = cubic("catmullRom", "nonperiodic")
    np.testing.assert_allclose(line[::8], CONTROL[1:-1], atol=1e-12)


@pytest.mark.parametrize(("basis", "count"), [("bezier", 6), ("bspline", 7), ("catmullRom", 7)])
def test_periodic_curves_close(basis: str, count: int) -> None:
    line = cubic(basis, "periodic", count)
    np.testing.assert_allclose(line[0], line[-1], atol=1e-12)
    assert len(line) == (count // 3 if basis == "bezier" else count) * 8 + 1


def test_counts_that_no_basis_can_have() -> None:
    assert is_basis_valid(np.array([4, 7]), "bezier", "nonperiodic")
    assert not is_basis_valid(np.array([4, 24]), "bezier", "nonperiodic")
    assert not is_basis_valid(np.array([3]), "bspline", "nonperiodic")
    assert not is_basis_valid(np.array([8]), "hermite", "nonperiodic")


def test_nurbs_with_weights_are_a_circle() -> None:
    half = np.sqrt(0.5)
    points = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    knots = np.array([0, 0, 0, 1, 1, 1], dtype=float)
    line, counts = nurbs_polylines(points, np.array([3]), np.array([3]), knots, np.array([1, half, 1]), "circle")
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1.0)
    assert counts.tolist() == [9]
    with pytest.raises(InputError, match="1 curves, 1 orders, 5 knots"):
        nurbs_polylines(points, np.array([3]), np.array([3]), knots[1:], None, "circle")
    with pytest.raises(InputError, match="do not decrease"):
        nurbs_polylines(points, np.array([3]), np.array([3]), knots[::-1], None, "circle")


@pytest.mark.shared_data
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) for name in ("v_invisible_copy", "v_proxy_and_render")]
    + ["u_instance"],
)
def test_hidden_curves_and_proxies_are_left_out(
    name: str, shared_data: Path, body: BodyModel, surface: Surface
) -> None:
    strands = read_strands(shared_data / f"cases/{name}.usda")
    expected = read_strands(shared_data / "cases/u_lib.usda")
    np.testing.assert_array_equal(strands.points, expected.points)
    if name != "u_instance":
        _, report = register_groom(strands, body, name)
        assert (report.kept, round(1e3 * report.scale, 1)) == (400, 10.0)


@pytest.mark.shared_data
def test_cubic_curves_of_a_file_have_their_own_length(shared_data: Path) -> None:
    """The control polygon of the B-splines is 49.4 cm long in the mean, resampled to 24 points 46.5 cm; the curves are
    36.73 cm by scipy, pinned or not, because their ends are three points in one."""
    stage = Usd.Stage.Open(str(shared_data / "cases/u_bspline.usda"))
    control = np.array(UsdGeom.Curves(stage.GetPrimAtPath("/Hair/c")).GetPointsAttr().Get(), dtype=float)
    curve = BSpline(np.arange(16.0), control.reshape(-1, 12, 3).transpose(1, 0, 2), 3)(np.linspace(3, 12, 1000))
    expected = np.linalg.norm(np.diff(curve, axis=0), axis=-1).sum(0)
    found = polyline_lengths(read_strands(shared_data / "cases/u_bspline.usda"))
    np.testing.assert_allclose(found, expected, rtol=2e-3)
    assert found.mean() == pytest.approx(36.73, abs=0.05)
    polygon = Strands(control.astype(np.float32), np.full(400, 12), "control")
    assert polyline_lengths(polygon).mean() == pytest.approx(49.41, abs=0.01)
    pinned = cubic_polylines(control, np.full(400, 12), "bspline", "pinned")
    assert polyline_lengths(Strands(*pinned, "pinned")).mean() == pytest.approx(36.73, abs=0.06)
    bezier = read_strands(shared_data / "cases/u_bezier.usda")
    ends = bezier.points[bezier.starts + bezier.counts - 1]
    whole = read_strands(shared_data / "cases/u_lib.usda")
    assert np.abs(bezier.roots - whole.roots).max() < 1e-4
    assert np.abs(ends - whole.points.reshape(400, 24, 3)[:, 21]).max() < 3.5


def test_nurbs_curves_and_packages_are_read(tmp_path: Path) -> None:
    path = tmp_path / "nurbs.usda"
    stage = Usd.Stage.CreateNew(str(path))
    curves = UsdGeom.NurbsCurves.Define(stage, "/hair")
    points = np.concatenate([CONTROL, CONTROL + np.array([5, 0, 0])])
    curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    curves.CreateCurveVertexCountsAttr([7, 7])
    curves.CreateOrderAttr([4, 4])
    curves.CreateKnotsAttr([*map(float, range(11))] * 2)
    UsdGeom.XformCommonAPI(curves).SetTranslate(Gf.Vec3d(0, 0, 10))
    stage.GetRootLayer().Save()
    strands = read_strands(path)
    line = cubic("bspline", "nonperiodic") + np.array([0, 0, 10])
    np.testing.assert_allclose(strands.points[: strands.counts[0]][::8], line[::8], atol=1e-5)
    from pxr import UsdUtils

    package = tmp_path / "nurbs.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(path), str(package))
    shutil.move(path, tmp_path / "elsewhere.usda")
    np.testing.assert_array_equal(read_strands(package).points, strands.points)


def test_a_stage_without_curves_says_what_it_has(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "mesh.usda"))
    UsdGeom.Mesh.Define(stage, "/head")
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match="BasisCurves or NurbsCurves, found no strands: no curves, only Mesh"):
        read_strands(tmp_path / "mesh.usda")
