"""What USD says of a groom for other programs: binding, texture coordinates, widths, materials, rate and frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdValidation

from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.hair import ExportClip, ExportSettings, Groom
from quaffure.io import read_usd_strands, usd, write_usd
from tests.export_clips import FRAMES, export_clip
from tests.training_runs import tiny_groom

STRANDS = 300


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.fixture(scope="module")
def clip(groom: Groom, body: BodyModel) -> ExportClip:
    return export_clip(groom, body, STRANDS, ExportSettings(points=10, every=2, guides=True))


@pytest.fixture(scope="module")
def stage(clip: ExportClip, tmp_path_factory: pytest.TempPathFactory) -> Usd.Stage:
    path = tmp_path_factory.mktemp("usd") / "drape.usd"
    write_usd(path, clip)
    return Usd.Stage.Open(str(path))


def strands_of(stage: Usd.Stage) -> UsdGeom.BasisCurves:
    return UsdGeom.BasisCurves.Get(stage, "/Drape/Hair/Strands")


def primvar(stage: Usd.Stage, name: str, prim: str = "/Drape/Hair/Strands") -> UsdGeom.Primvar:
    return UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(prim)).GetPrimvar(name)


def test_validates_without_a_warning(stage: Usd.Stage) -> None:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in found] == []


def test_roots_have_the_texture_coordinates_of_the_body_there(stage: Usd.Stage, clip: ExportClip) -> None:
    body = UsdGeom.Mesh.Get(stage, "/Drape/Body")
    faces = np.array(body.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    texture = primvar(stage, "st", "/Drape/Body")
    assert (texture.GetInterpolation(), str(texture.GetTypeName())) == ("faceVarying", "texCoord2f[]")
    uv = np.array(texture.Get()).reshape(-1, 3, 2)
    root_uv = primvar(stage, "groom_root_uv")
    assert root_uv.GetInterpolation() == "uniform"
    triangles = np.array(body.GetPointsAttr().Get(0))[faces]
    roots = np.array(strands_of(stage).GetPointsAttr().Get(0)).reshape(STRANDS, 10, 3)[:, 0]
    for root, found in zip(roots[::30], np.array(root_uv.Get())[::30]):
        # By brute force: the root is a mean of the corners of its triangle, with weights above 0 that sum to 1.
        near = np.argsort(np.linalg.norm(triangles.mean(1) - root, axis=1))[:20]
        weights = np.linalg.solve(triangles[near].transpose(0, 2, 1).astype(float), np.tile(root[:, None], (20, 1, 1)))
        outside = np.abs(weights[..., 0].sum(1) - 1) + np.clip(-weights[..., 0], 0, None).sum(1)
        inside = int(outside.argmin())
        np.testing.assert_allclose((weights[inside, :, 0] @ uv[near[inside]]), found, atol=1e-3)


def test_the_body_is_bound_to_the_groom(stage: Usd.Stage) -> None:
    body = stage.GetPrimAtPath("/Drape/Body")
    assert "GroomBindingAPI" in str(body.GetMetadata("apiSchemas"))
    (target,) = body.GetRelationship("unreal:groomBinding:groom").GetTargets()
    assert "GroomAPI" in str(stage.GetPrimAtPath(target).GetMetadata("apiSchemas"))


def test_hair_and_body_have_materials(stage: Usd.Stage) -> None:
    for prim, name in (("/Drape/Body", "Body"), ("/Drape/Hair/Strands", "Hair"), ("/Drape/Hair/Guides", "Hair")):
        material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(prim)).ComputeBoundMaterial()
        assert material.GetPath().name == name
        shader, _, _ = material.ComputeSurfaceSource()
        assert shader.GetIdAttr().Get() == "UsdPreviewSurface"


def test_rate_and_frames_are_those_of_the_clip(stage: Usd.Stage, clip: ExportClip) -> None:
    assert (stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()) == (24.0, 24.0)
    curves = strands_of(stage)
    assert curves.GetPointsAttr().GetTimeSamples() == [0.0, 2.0]
    assert stage.GetEndTimeCode() == FRAMES - 2
    np.testing.assert_array_equal(np.array(curves.GetPointsAttr().Get(2)), clip.strands(2).reshape(-1, 3))
    np.testing.assert_array_equal(np.array(primvar(stage, "rest").Get()), clip.rest_points)


def test_strands_name_their_guides(stage: Usd.Stage, clip: ExportClip) -> None:
    ids = [np.array(primvar(stage, "groom_id", f"/Drape/Hair/{name}").Get()) for name in ("Guides", "Strands")]
    assert len({*np.concatenate(ids).tolist()}) == 40 + STRANDS
    closest, weights = primvar(stage, "groom_closest_guides"), primvar(stage, "groom_guide_weights")
    assert (str(closest.GetTypeName()), str(weights.GetTypeName())) == ("int3[]", "float3[]")
    assert clip.interpolation is not None
    np.testing.assert_array_equal(np.array(closest.Get()), clip.interpolation.guides)
    np.testing.assert_allclose(np.array(weights.Get()).sum(1), 1, atol=1e-5)


def test_widths_and_colours(stage: Usd.Stage, clip: ExportClip) -> None:
    widths = np.array(strands_of(stage).GetWidthsAttr().Get()).reshape(STRANDS, 10)
    np.testing.assert_array_equal(widths[5], clip.strand_width)
    assert len(primvar(stage, "groom_color").Get()) == 10 * STRANDS


def test_fewer_points_stay_on_the_strand(groom: Groom, body: BodyModel) -> None:
    whole, few = export_clip(groom, body), export_clip(groom, body, settings=ExportSettings(points=8))
    strands, resampled = whole.strands(2), few.strands(2)
    np.testing.assert_array_equal(resampled[:, [0, -1]], strands[:, [0, -1]])
    start, edge = strands[:, None, :-1], np.diff(strands, axis=1)[:, None]
    offset = resampled[:, :, None] - start
    along = np.clip((offset * edge).sum(-1) / (edge**2).sum(-1), 0, 1)
    assert np.linalg.norm(offset - along[..., None] * edge, axis=-1).min(2).max() < 1e-6
    lengths = np.linalg.norm(np.diff(resampled, axis=1), axis=-1)
    assert (lengths.std(axis=1) < 0.1 * lengths.mean(axis=1)).all()
    again = export_clip(groom, body, settings=ExportSettings(points=24)).strands(2)
    np.testing.assert_array_equal(again, strands)


def test_a_layer_that_is_saved_as_it_grows_is_the_same(
    clip: ExportClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_usd(tmp_path / "whole.usdc", clip)
    monkeypatch.setattr(usd, "UNSAVED_BYTES", 0)
    write_usd(tmp_path / "parts.usdc", clip)
    layers = [Sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usdc")) for name in ("whole", "parts")]
    texts = [layer.ExportToString() for layer in layers]
    assert texts[0] == texts[1]


def test_layers_of_frames_are_the_stage(groom: Groom, body: BodyModel, tmp_path: Path) -> None:
    """Value clips: positions, also between frames of two layers, bounds and times are those of one file."""
    whole = export_clip(groom, body, STRANDS, ExportSettings(guides=True))
    write_usd(tmp_path / "one.usd", whole)
    write_usd(tmp_path / "walk.usd", replace(whole, settings=ExportSettings(guides=True, frames_per_layer=3)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.usd", "walk.0000.usd", "walk.0003.usd", "walk.usd"]
    assert (tmp_path / "walk.usd").stat().st_size < (tmp_path / "one.usd").stat().st_size / 2
    one, layered = (Usd.Stage.Open(str(tmp_path / name)) for name in ("one.usd", "walk.usd"))
    for name in ("Body", "Hair/Strands", "Hair/Guides"):
        for attribute in ("points", "extent"):
            expected, found = (each.GetPrimAtPath(f"/Drape/{name}").GetAttribute(attribute) for each in (one, layered))
            assert found.GetTimeSamples() == [0.0, 1.0, 2.0, 3.0]
            for time in (0.0, 1.5, 2.5, 3.0):
                np.testing.assert_array_equal(np.array(found.Get(time)), np.array(expected.Get(time)))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(layered)
    assert [error.GetErrorAsString() for error in found] == []
    strands = read_usd_strands(tmp_path / "walk.usd")
    np.testing.assert_allclose(strands.points, whole.points(0), atol=1e-6)
    with pytest.raises(InputError, match="frames-per-layer"):
        ExportSettings(frames_per_layer=0)


def test_a_layer_that_would_replace_a_file_is_refused(
    tmp_path: Path, tiny_groom_file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    options = ["--draper", "posed", "--motion", "nod", "--frames", "0:4", "--frames-per-layer", "2"]
    outputs = ["--out", str(tmp_path / "nod.usd"), "--out", str(tmp_path / "nod.0002.usd")]
    with pytest.raises(SystemExit):
        main(["drape", str(tiny_groom_file), *options, *outputs])
    assert "nod.0002.usd: expected outputs that differ" in capfd.readouterr().err
    assert [*tmp_path.iterdir()] == []
    main(["drape", str(tiny_groom_file), *options, *outputs[:2]])
    assert "frames in 2 layers, nod.0000.usd to nod.0002.usd" in "".join(capfd.readouterr().out.split("\n"))


def test_the_command_takes_every_option(tmp_path: Path, tiny_groom_file: Path) -> None:
    options = ["--motion", "nod", "--frames", "0:5", "--points", "6", "--every", "4", "--guides", "--strands", "30"]
    main(["drape", str(tiny_groom_file), "--draper", "posed", *options, "--out", str(tmp_path / "hair.usda")])
    stage = Usd.Stage.Open(str(tmp_path / "hair.usda"))
    assert list(strands_of(stage).GetCurveVertexCountsAttr().Get()) == [6] * 30
    assert strands_of(stage).GetPointsAttr().GetTimeSamples() == [0.0, 4.0]
    assert len(UsdGeom.BasisCurves.Get(stage, "/Drape/Hair/Guides").GetCurveVertexCountsAttr().Get()) > 30
