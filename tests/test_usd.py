from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdValidation

from quaffure import InputError
from quaffure.geometry import farthest_points
from quaffure.hair import ExportClip, ExportSettings
from quaffure.io import read_usd_strands, write_usd
from tests.synthetic_drape import drape, patch_of_strands

STRANDS = patch_of_strands((0.0, 1.0, 0.0))


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Usd.Stage:
    path = tmp_path_factory.mktemp("usd") / "drape.usd"
    write_usd(path, ExportClip(drape(STRANDS), settings=ExportSettings(guides=True)))
    return Usd.Stage.Open(str(path))


def validation_errors(stage: Usd.Stage) -> list[str]:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [error.GetErrorAsString() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


def test_stage_says_its_conventions(stage: Usd.Stage) -> None:
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (30.0, 0.0, 2.0)
    assert str(stage.GetDefaultPrim().GetPath()) == "/Drape"


def test_positions_of_every_frame_survive(stage: Usd.Stage) -> None:
    expected = drape(STRANDS)
    curves = UsdGeom.BasisCurves.Get(stage, "/Drape/Hair/Strands")
    body = UsdGeom.Mesh.Get(stage, "/Drape/Body")
    assert list(curves.GetCurveVertexCountsAttr().Get()) == [8] * 150
    for points, positions in ((curves, expected.strands), (body, expected.body_vertices)):
        assert points.GetPointsAttr().GetTimeSamples() == [0.0, 1.0, 2.0]
        for frame in range(3):
            found = np.array(points.GetPointsAttr().Get(frame))
            np.testing.assert_array_equal(found, positions[frame].reshape(-1, 3))
    np.testing.assert_array_equal(np.array(body.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), expected.body_faces)


def test_groom_attributes(stage: Usd.Stage) -> None:
    expected = drape(STRANDS)
    for name, guide, chosen in (
        ("Strands", 0, np.arange(150)),
        ("Guides", 1, farthest_points(expected.posed[0, :, 0], 128)),
    ):
        curves = UsdGeom.BasisCurves.Get(stage, f"/Drape/Hair/{name}")
        primvars = UsdGeom.PrimvarsAPI(curves)
        assert set(primvars.GetPrimvar("groom_guide").Get()) == {guide}
        np.testing.assert_array_equal(
            primvars.GetPrimvar("groom_id").Get(), np.arange(len(chosen)) + (0 if guide else 128)
        )
        np.testing.assert_array_equal(primvars.GetPrimvar("rest").Get(), expected.posed[0, chosen].reshape(-1, 3))
        assert len(curves.GetWidthsAttr().Get()) == 8 * len(chosen)
        assert curves.GetPurposeAttr().Get() == ("guide" if guide else "default")
    assert "GroomAPI" in str(stage.GetPrimAtPath("/Drape/Hair").GetMetadata("apiSchemas"))


def test_extent_holds_every_frame(stage: Usd.Stage) -> None:
    for frame in range(3):
        lowest, highest = np.array(UsdGeom.Boundable.Get(stage, "/Drape/Hair/Strands").GetExtentAttr().Get(frame))
        assert (lowest <= drape(STRANDS).strands[frame].min(axis=(0, 1))).all()
        assert (highest >= drape(STRANDS).strands[frame].max(axis=(0, 1))).all()


def test_validates(stage: Usd.Stage) -> None:
    assert validation_errors(stage) == []


def test_validation_would_object() -> None:
    broken = Usd.Stage.CreateInMemory()
    UsdGeom.Mesh.Define(broken, "/Body")
    assert validation_errors(broken)


@pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc"])
def test_written_strands_are_read(tmp_path: Path, suffix: str) -> None:
    write_usd(tmp_path / f"drape{suffix}", drape(STRANDS))
    strands = read_usd_strands(tmp_path / f"drape{suffix}")
    assert strands.counts.tolist() == [8] * 150
    np.testing.assert_allclose(strands.points.reshape(150, 8, 3), STRANDS, atol=1e-6)
    assert [file.name for file in tmp_path.iterdir()] == [f"drape{suffix}"]


def test_reader_applies_transforms_and_joins_prims(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "curves.usda"))
    for name, counts in (("A", [2, 3]), ("B", [1, 2])):
        curves = UsdGeom.BasisCurves.Define(stage, f"/{name}")
        curves.CreatePointsAttr([(i, 0, 0) for i in range(sum(counts))])
        curves.CreateCurveVertexCountsAttr(counts)
    UsdGeom.Xformable(stage.GetPrimAtPath("/B")).AddTranslateOp().Set((0, 0, 5))
    UsdGeom.Xformable(stage.GetPrimAtPath("/B")).AddRotateZOp().Set(90)
    stage.Save()
    strands = read_usd_strands(tmp_path / "curves.usda")
    assert strands.counts.tolist() == [2, 3, 2]
    np.testing.assert_allclose(strands.points[5:], [[0, 1, 5], [0, 2, 5]], atol=1e-6)


@pytest.mark.parametrize("vertices", [2, 4, 7])
def test_held_parts_of_strands_of_few_vertices_are_read(vertices: int, tmp_path: Path) -> None:
    strands = patch_of_strands((0.0, 1.0, 0.0), vertices)
    random, shape = np.random.default_rng(0), (len(strands), vertices - 1)
    held = replace(
        drape(strands),
        stiffness_scale=1 + random.random(shape, np.float32),
        goal_weight=random.random(shape, np.float32),
        tie_vertex=random.integers(-1, vertices, len(strands)),
    )
    write_usd(tmp_path / "held.usda", held)
    found = read_usd_strands(tmp_path / "held.usda")
    np.testing.assert_array_equal(found.points.reshape(strands.shape), strands)
    np.testing.assert_array_equal(found.tie_vertex, held.tie_vertex)
    for name in ("stiffness_scale", "goal_weight"):
        np.testing.assert_array_equal(getattr(found, name).reshape(-1, vertices)[:, :-1], getattr(held, name))
    write_usd(tmp_path / "free.usda", drape(strands))
    assert (read_usd_strands(tmp_path / "free.usda").counts > vertices).all()


@pytest.mark.parametrize(
    ("flags", "lengths"), [([1, 0], [3]), ([1, 1], [2, 3]), ([0, 0], [2, 3]), ([1], [2, 3]), ([1, 0, 1], [2, 3])]
)
def test_guides_by_unreals_primvar_are_left_out_where_there_are_others(
    flags: list[int], lengths: list[int], tmp_path: Path
) -> None:
    """Of each curve, of all of them, or of another number, which says nothing."""
    stage = stage_of_curves(tmp_path / "hair.usda", "/Hair")
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Hair"))
    interpolation = UsdGeom.Tokens.constant if len(flags) == 1 else UsdGeom.Tokens.uniform
    primvars.CreatePrimvar("groom_guide", Sdf.ValueTypeNames.IntArray, interpolation).Set(flags)
    primvars.CreatePrimvar("groom_id", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.uniform).Set([2, 3])
    stage.Save()
    found = read_usd_strands(tmp_path / "hair.usda")
    assert found.counts.tolist() == lengths
    assert found.attributes.identifier is not None
    assert found.attributes.identifier.tolist() == lengths


@pytest.mark.parametrize("kind", [Sdf.ValueTypeNames.Int, Sdf.ValueTypeNames.Bool])
def test_a_primvar_of_one_number_makes_guides_of_all_curves(kind: Sdf.ValueTypeName, tmp_path: Path) -> None:
    stage = stage_of_curves(tmp_path / "hair.usda", "/Hair", "/Guides")
    UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Guides")).CreatePrimvar("groom_guide", kind).Set(True)
    stage.Save()
    found = read_usd_strands(tmp_path / "hair.usda")
    assert (found.counts.tolist(), found.attributes.group_names) == ([2, 3], ("/Hair",))


def test_guides_that_another_program_gives_the_default_purpose_stay_guides(tmp_path: Path) -> None:
    path = tmp_path / "drape.usda"
    write_usd(path, ExportClip(drape(STRANDS), settings=ExportSettings(guides=True)))
    stage = Usd.Stage.Open(str(path))
    UsdGeom.BasisCurves.Get(stage, "/Drape/Hair/Guides").GetPurposeAttr().Set(UsdGeom.Tokens.default_)
    stage.Save()
    assert len(read_usd_strands(path)) == len(STRANDS)


def stage_of_curves(path: Path, *names: str) -> Usd.Stage:
    """A stage with prims of a curve of two points and one of three each."""
    stage = Usd.Stage.CreateNew(str(path))
    for name in names:
        curves = UsdGeom.BasisCurves.Define(stage, name)
        curves.CreatePointsAttr([(i, 0, 0) for i in range(5)])
        curves.CreateCurveVertexCountsAttr([2, 3])
    return stage


def test_bad_input_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken.usda").write_text("#usda 1.0\ndef {{{")
    (tmp_path / "broken.usdc").write_bytes(b"PXR-USDC" + bytes(100))
    Usd.Stage.CreateNew(str(tmp_path / "empty.usda")).Save()
    for name in ("broken.usda", "broken.usdc", "empty.usda", "missing.usd"):
        with pytest.raises(InputError, match=name):
            read_usd_strands(tmp_path / name)
    with pytest.raises(InputError, match=r"\.usd"):
        write_usd(tmp_path / "drape.abc", drape(STRANDS))


def test_farthest_points_cover() -> None:
    roots = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [10, 0, 0], [0, 10, 0]], dtype=np.float32)
    assert set(farthest_points(roots, 3)) == {0, 3, 4}
    assert farthest_points(roots, 99).tolist() == [0, 1, 2, 3, 4]
    assert len(set(farthest_points(np.zeros((6, 3), np.float32), 4))) == 4
