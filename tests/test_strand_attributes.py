"""Widths, colours, ids, groups and root coordinates of strands, from every format that has them."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from quaffure.body import BodyModel
from quaffure.hair import PlacedStrands, StrandAttributes, Strands, concatenate_strands
from quaffure.hair.strand_attributes import along_points, unique_identifiers
from quaffure.io import read_source, write_groom
from quaffure.io.hair import read_hair
from quaffure.io.ply import linear_of, srgb_of
from quaffure.io.read_strands import read_strands
from tests.test_groom_files import RAGGED, hair_bytes
from tests.test_strand_formats import POINTS, needs_alembic, ply
from tests.training_runs import tiny_groom

EVERY = StrandAttributes(
    width=np.arange(7.0),
    colour=np.arange(21.0).reshape(7, 3),
    identifier=np.array([5, 9]),
    group=np.array([1, 0]),
    root_uv=np.array([[0.1, 0.2], [0.3, 0.4]]),
    group_names=("hair", "brows"),
)
STRANDS = Strands(np.float32(POINTS), np.array([3, 4]), "made up", attributes=EVERY)


def test_selected_strands_keep_their_own() -> None:
    found = STRANDS.select(np.array([False, True])).attributes
    assert found.width is not None
    assert found.width.tolist() == [3, 4, 5, 6]
    assert (found.identifier.tolist(), found.group.tolist()) == ([9], [0])
    assert found.root_uv.tolist() == [[0.3, 0.4]]
    assert found.colour.shape == (4, 3)


def test_parts_keep_their_groups() -> None:
    other = Strands(np.float32(POINTS[:2]), np.array([2]), "hair/beard.tfx")
    found = concatenate_strands([STRANDS, other, STRANDS]).attributes
    assert found.group.tolist() == [1, 0, 2, 4, 3]
    assert found.group_names == ("hair", "brows", "beard", "hair", "brows")
    assert found.identifier.tolist() == [5, 9, -1, 5, 9]
    assert concatenate_strands([STRANDS]).attributes.group_names == ("hair", "brows")
    assert concatenate_strands([other]).attributes.group is None


def test_parts_without_widths_and_colours_get_those_of_the_others() -> None:
    """No strand vanishes or turns black beside another file; no root gets a place on the skin that none gave it."""
    other = Strands(np.float32(POINTS[:2]), np.array([2]), "other")
    zeros = Strands(np.float32(POINTS[:2]), np.array([2]), "zeros", attributes=StrandAttributes(width=np.zeros(2)))
    found = concatenate_strands([STRANDS, other, zeros]).attributes
    assert found.width.tolist() == [0, 1, 2, 3, 4, 5, 6, 3, 3, 3, 3]
    np.testing.assert_array_equal(found.colour[7:], np.tile(EVERY.colour.mean(axis=0), (4, 1)))
    assert found.root_uv is None
    assert concatenate_strands([other, zeros]).attributes.width is None


def test_groups_of_one_name_are_one() -> None:
    found = StrandAttributes(group=np.array([2, 1, -1, 0]), group_names=("top", "side", "top")).with_groups_by_name()
    assert (found.group.tolist(), found.group_names) == ([0, 1, -1, 0], ("top", "side"))


def test_ids_become_unique() -> None:
    assert unique_identifiers(np.array([-1, 4, 4, 0, 2**40, -7])).tolist() == [5, 4, 6, 0, 7, 8]
    assert unique_identifiers(np.array([-1, -1])) is None
    assert unique_identifiers(None) is None


def test_numbers_that_are_none_are_left_out() -> None:
    for width in ([1.0, np.inf], [1.0, -1.0], [0.0, 0.0]):
        found = StrandAttributes(width=np.array(width), colour=np.ones((2, 3))).usable()
        assert found.width is None
        assert found.colour is not None
    assert StrandAttributes(width=np.array([1.0, 0.0])).usable().width is not None


def test_values_of_control_points_spread_along_curves() -> None:
    found = along_points(np.array([0.0, 1.0, 2.0, 10.0, 20.0]), np.array([3, 2]), np.array([5, 3]))
    np.testing.assert_allclose(found, [0, 0.5, 1, 1.5, 2, 10, 15, 20])


def test_hair_files_have_thickness_and_colour(tmp_path: Path) -> None:
    (tmp_path / "hair.hair").write_bytes(hair_bytes(RAGGED, 31))
    found = read_hair(tmp_path / "hair.hair").attributes
    assert found.width.shape == (9,)
    assert found.colour.shape == (9, 3)
    (tmp_path / "plain.hair").write_bytes(hair_bytes(RAGGED, 3))
    plain = read_hair(tmp_path / "plain.hair").attributes
    np.testing.assert_allclose(plain.width, 0.1)  # the default thickness of the header
    assert plain.colour is None


def test_ply_colours(tmp_path: Path) -> None:
    kind = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows = np.zeros(7, kind)
    rows["xyz"], rows["rgb"] = POINTS, np.arange(21).reshape(7, 3)
    header = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    content = rows.tobytes() + np.array([2, 3], "<u2").tobytes()
    (tmp_path / "hair.ply").write_bytes(ply(f"{header}element strand 2\nproperty ushort nsegs\n", content))
    found = read_strands(tmp_path / "hair.ply").attributes.colour
    # Middle grey in sRGB is 21.4 % in linear RGB; a viewer's 8 bits are sRGB.
    assert found[0, 2] == pytest.approx(2 / 255 / 12.92)
    np.testing.assert_allclose(linear_of(np.array([[0.5, 1, 0]])), [[0.2140, 1, 0]], atol=1e-4)
    every = np.arange(256).repeat(3).reshape(-1, 3)
    np.testing.assert_array_equal(srgb_of(linear_of(every / 255)), every)


def test_ply_properties_of_other_names(tmp_path: Path) -> None:
    kind = np.dtype([("xyz", "<f4", 3), ("rgb", "<f4", 3), ("radius", "<f4")])
    rows = np.zeros(7, kind)
    rows["xyz"], rows["rgb"], rows["radius"] = POINTS, np.arange(21).reshape(7, 3) / 21, np.arange(7)
    header = "".join(f"property float {name}\n" for name in ("red", "green", "blue", "radius"))
    strand = "element strand 2\nproperty ushort nsegs\nproperty ushort group_id\nproperty ushort u\nproperty ushort v\n"
    content = rows.tobytes() + np.array([2, 7, 0, 1, 3, 4, 1, 0], "<u2").tobytes()
    (tmp_path / "hair.ply").write_bytes(ply(f"{header}{strand}", content))
    found = read_strands(tmp_path / "hair.ply").attributes
    assert found.width.tolist() == [0, 2, 4, 6, 8, 10, 12]
    np.testing.assert_allclose(found.colour, np.arange(21).reshape(7, 3) / 21, rtol=1e-6)
    assert (found.group.tolist(), found.group_names) == ([1, 0], ("group/4", "group/7"))
    assert (found.root_uv.tolist(), found.identifier) == ([[0, 1], [1, 0]], None)


def test_usd_primvars(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(tmp_path / "hair.usda"))
    for name, first in (("Hair", 0), ("Beard", 100)):
        curves = UsdGeom.BasisCurves.Define(stage, f"/{name}")
        curves.CreateTypeAttr("linear")
        curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.float32(POINTS)))
        curves.CreateCurveVertexCountsAttr([3, 4])
        curves.CreateWidthsAttr([0.1, 0.2])
        curves.AddScaleOp().Set((2.0, 2.0, 2.0) if name == "Beard" else (1.0, 1.0, 1.0))
        primvars = UsdGeom.PrimvarsAPI(curves)
        uniform = UsdGeom.Tokens.uniform
        primvars.CreatePrimvar("groom_id", Sdf.ValueTypeNames.IntArray, uniform).Set([first, first + 1])
        primvars.CreatePrimvar("st", Sdf.ValueTypeNames.Float2Array, uniform).Set([(0.1, 0.2), (0.3, 0.4)])
        primvars.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray).Set([(0.5, 0.25, 0.125)])
    stage.Save()
    found = read_strands(tmp_path / "hair.usda").attributes
    assert (found.group_names, found.group.tolist()) == (("/Hair", "/Beard"), [0, 0, 1, 1])
    assert found.identifier.tolist() == [0, 1, 100, 101]
    np.testing.assert_allclose(found.width, [0.1] * 3 + [0.2] * 4 + [0.2] * 3 + [0.4] * 4, rtol=1e-6)
    np.testing.assert_allclose(found.root_uv, [[0.1, 0.2], [0.3, 0.4]] * 2, rtol=1e-6)
    np.testing.assert_allclose(found.colour, [[0.5, 0.25, 0.125]] * 14)


def test_usd_names_of_groups(tmp_path: Path) -> None:
    """Unreal's names win over those of prims, and join groups of several prims; numbers give the order."""
    pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(tmp_path / "hair.usda"))
    uniform, constant = UsdGeom.Tokens.uniform, UsdGeom.Tokens.constant
    for name in ("One", "Two", "Three"):
        curves = UsdGeom.BasisCurves.Define(stage, f"/{name}")
        curves.CreateTypeAttr("linear")
        curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.float32(POINTS)))
        curves.CreateCurveVertexCountsAttr([3, 4])
        primvars = UsdGeom.PrimvarsAPI(curves)
        if name == "One":
            primvars.CreatePrimvar("groom_group_id", Sdf.ValueTypeNames.IntArray, uniform).Set([3, 1])
            primvars.CreatePrimvar("groom_group_name", Sdf.ValueTypeNames.StringArray, uniform).Set(["tail", "top"])
        elif name == "Two":
            primvars.CreatePrimvar("groom_group_name", Sdf.ValueTypeNames.String, constant).Set("tail")
        else:
            primvars.CreatePrimvar("groom_group_id", Sdf.ValueTypeNames.IntArray, uniform).Set([8, 6])
    stage.Save()
    found = read_strands(tmp_path / "hair.usda").attributes
    assert found.group_names == ("top", "tail", "/Three/6", "/Three/8")
    assert found.group.tolist() == [1, 0, 1, 1, 3, 2]


@needs_alembic
def test_alembic_names_of_groups(tmp_path: Path) -> None:
    from tests.alembic_curves import write_curves

    whole = {"points": POINTS, "counts": [3, 4]}
    named = whole | {"texts": {"groom_group_name": ["tail", "top"]}, "integers": {"groom_group_id": [3, 1]}}
    constant = whole | {"texts": {"groom_group_name": ["tail"]}}
    write_curves(tmp_path / "hair.abc", {"one": named, "two": constant, "three": whole})
    found = read_strands(tmp_path / "hair.abc").attributes
    assert found.group_names == ("top", "tail", "/three/curves")
    assert found.group.tolist() == [1, 0, 1, 1, 2, 2]


@needs_alembic
def test_alembic_texts_of_another_number_are_not_read(tmp_path: Path) -> None:
    """A damaged file may have millions, of which Python would make an object each."""
    from quaffure.io import alembic_curves
    from tests.alembic_curves import write_curves

    many = {"groom_group_name": [f"name {index}" for index in range(20_000)]}
    curves = {"points": np.arange(18.0).reshape(6, 3), "counts": [3, 3], "texts": many}
    write_curves(tmp_path / "hair.abc", {"hair": curves})
    tracemalloc.start()
    strands = alembic_curves._read_archive(tmp_path / "hair.abc")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert strands.attributes.group_names == ("/hair/curves",)
    assert peak < 500_000


@needs_alembic
def test_alembic_groups_and_ids(tmp_path: Path) -> None:
    from tests.alembic_curves import write_curves

    whole = {"points": POINTS, "counts": [3, 4]}
    more = {"groom_id": [7, 8], "groom_group_id": [4, 2]}
    write_curves(tmp_path / "hair.abc", {"hair": whole | {"integers": more}, "beard": whole})
    found = read_strands(tmp_path / "hair.abc").attributes
    assert found.identifier.tolist() == [7, 8, -1, -1]
    assert found.group.tolist() == [1, 0, 2, 2]
    assert found.group_names == ("/hair/curves/2", "/hair/curves/4", "/beard/curves")


def test_groom_files_keep_them(tmp_path: Path, body: BodyModel) -> None:
    truths = np.array([True, False])
    placed = PlacedStrands(np.float32(POINTS), np.array([3, 4]), truths, ~truths, EVERY)
    write_groom(tmp_path / "groom.npz", tiny_groom(body), placed)
    found = read_source(tmp_path / "groom.npz")
    assert found is not None
    for name, values in EVERY.arrays().items():
        np.testing.assert_array_equal(found.attributes.arrays()[name], values)
