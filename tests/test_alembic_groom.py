"""Alembic files of grooms: numbers followed by hand, the schema of Unreal's importer, and pairs of asset and cache."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.hair import ExportClip, ExportSettings, Groom
from quaffure.io import write_drape
from quaffure.io.read_strands import read_strands
from tests.export_clips import FRAMES, export_clip
from tests.synthetic_drape import drape, patch_of_strands
from tests.training_runs import tiny_groom

alembic3d = pytest.importorskip("alembic3d")
from alembic3d import Abc, AbcGeom  # noqa: E402

from quaffure.io.alembic_groom import write_groom_asset, write_groom_cache  # noqa: E402
from scripts import check_unreal_groom  # noqa: E402
from tests.alembic_curves import write_curves  # noqa: E402

STRANDS = 300


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.fixture(scope="module")
def clip(groom: Groom, body: BodyModel) -> ExportClip:
    return export_clip(groom, body, STRANDS, ExportSettings(points=12))


@pytest.fixture(scope="module")
def pair(clip: ExportClip, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("alembic")
    write_groom_asset(folder / "walk_groom.abc", clip)
    write_groom_cache(folder / "walk.abc", clip)
    return folder / "walk_groom.abc", folder / "walk.abc"


def curves_of(path: Path, name: str) -> "AbcGeom.ICurvesSchema":
    return AbcGeom.ICurves(Abc.IArchive(str(path)).getTop().getChild("groom").getChild(name), "curves").getSchema()


def points_of(path: Path, name: str, frame: int) -> np.ndarray:
    schema = curves_of(path, name)
    sample = schema.getValue(Abc.ISampleSelector(schema.getTimeSampling().getSampleTime(frame)))
    return np.array(sample.getPositions()).reshape(len(sample.getCurvesNumVertices()), -1, 3)


def attribute(path: Path, curves: str, name: str) -> np.ndarray:
    return np.array([*curves_of(path, curves).getArbGeomParams().getProperty(name).getValue()])


def test_one_vertex_and_one_root_by_hand(tmp_path: Path, groom: Groom, body: BodyModel) -> None:
    """(1, 2, 3) m is (100, -200, 300) cm in Unreal's axes; texture coordinates are those of the body."""
    sequence = drape(patch_of_strands((0.0, 1.0, 0.0)))
    sequence.strands[1, 7, 0] = (1.0, 2.0, 3.0)
    write_groom_cache(tmp_path / "hair.abc", ExportClip(sequence))
    assert points_of(tmp_path / "hair.abc", "strands", 1)[7, 0].tolist() == [100.0, -200.0, 300.0]
    whole = export_clip(groom, body)
    write_groom_asset(tmp_path / "groom.abc", whole)
    np.testing.assert_allclose(attribute(tmp_path / "groom.abc", "strands", "groom_root_uv")[7], groom.root_uv[7])
    assert "(x, y, z) m of the drape is (100 x, -100 y, 100 z)" in str(
        Abc.GetArchiveInfo(Abc.IArchive(str(tmp_path / "groom.abc")))
    )


@pytest.mark.parametrize("write", [write_groom_asset, write_groom_cache])
def test_what_is_written_for_unreal_is_read_in_the_axes_of_the_drape(
    write: Callable[[Path, ExportClip], None], tmp_path: Path
) -> None:
    """Hair of one side is not read as its mirror image: (x, y, z) m is read as (100 x, 100 y, 100 z)."""
    strands = patch_of_strands((1.0, 0.5, 0.3))
    clip = ExportClip(drape(strands))
    write(tmp_path / "hair.abc", clip)
    assert (points_of(tmp_path / "hair.abc", "strands", 0)[..., 1] < 0).all()
    found = read_strands(tmp_path / "hair.abc")
    np.testing.assert_allclose(found.points, 100 * strands.reshape(-1, 3), rtol=1e-6)
    assert found.attributes.width is not None
    np.testing.assert_allclose(found.attributes.width, 100 * clip.widths, rtol=1e-6)
    as_read, _, _, _ = np.linalg.lstsq(clip.points(0), found.points, rcond=None)
    assert np.linalg.det(as_read) == pytest.approx(1e6, rel=1e-4)


@pytest.mark.parametrize(
    ("tool", "y"), [("quaffure 0.0.1", -1), ("quaffurette 1.0", 1), ("Another 2 (quaffure)", 1), ("", 1)]
)
def test_only_grooms_of_this_package_are_mirrored_as_they_are_read(tool: str, y: int, tmp_path: Path) -> None:
    """Those of all of its versions; before the transforms that other programs put around them."""
    points = np.arange(9.0).reshape(3, 3)
    hair = {"points": points, "counts": [3], "move": (1, 2, 3)}
    others = {"points": points + 20, "counts": [3]}
    write_curves(tmp_path / "hair.abc", {"hair": hair | {"tool": tool}, "others": others})
    expected = np.concatenate([points * [1, y, 1] + [1, 2, 3], points + 20])
    np.testing.assert_array_equal(read_strands(tmp_path / "hair.abc").points, expected)


def test_unreals_schema_finds_no_fault(pair: tuple[Path, Path]) -> None:
    asset, cache = map(str, pair)
    assert check_unreal_groom.main([asset, cache]) == 0
    faults, curves = check_unreal_groom.check(cache, is_cache=True)
    assert faults == []
    guides, strands = curves
    assert (len(guides.counts), len(strands.counts), strands.frames) == (40, STRANDS, FRAMES)
    assert set(strands.attributes) == set(check_unreal_groom.CURVE_ATTRIBUTES)


def test_frames_and_rest_are_those_of_the_clip(pair: tuple[Path, Path], clip: ExportClip) -> None:
    asset, cache = pair
    axes = np.float32([100, -100, 100])
    for frame in range(FRAMES):
        np.testing.assert_array_equal(points_of(cache, "strands", frame), clip.strands(frame) * axes)
        np.testing.assert_array_equal(points_of(cache, "guides", frame), clip.guides(frame) * axes)
    np.testing.assert_array_equal(
        points_of(asset, "strands", 0), clip.rest_points.reshape(-1, clip.point_count, 3) * axes
    )
    assert curves_of(asset, "strands").getNumSamples() == 1
    times = curves_of(cache, "strands").getTimeSampling()
    assert [times.getSampleTime(frame) for frame in range(FRAMES)] == pytest.approx([f / 24 for f in range(FRAMES)])


def test_strands_follow_from_their_closest_guides(pair: tuple[Path, Path], groom: Groom) -> None:
    """Tips are means of the guides' tips relative to the roots, but for curls, with the weights in the file."""
    asset, _ = pair
    ids = attribute(asset, "guides", "groom_id").tolist()
    closest, weights = (attribute(asset, "strands", f"groom_{name}") for name in ("closest_guides", "guide_weights"))
    guides, strands = points_of(asset, "guides", 0), points_of(asset, "strands", 0)
    index = np.vectorize(ids.index)(closest)
    offset = guides[:, -1] - guides[:, 0]
    expected = (weights[..., None] * offset[index]).sum(1)
    assert np.abs(strands[:, -1] - strands[:, 0] - expected).max() < 0.8  # cm, of hair of 20 cm
    assert not set(ids) & set(attribute(asset, "strands", "groom_id").tolist())


def test_width_and_colour(pair: tuple[Path, Path], clip: ExportClip) -> None:
    asset, _ = pair
    width = attribute(asset, "strands", "groom_width").reshape(STRANDS, 12)
    assert width[0, 0] == pytest.approx(0.08)  # cm: 0.8 mm, as few as there are
    assert (np.diff(width, axis=1) < 0).all()
    np.testing.assert_allclose(
        curves_of(asset, "strands").getWidthsParam().getValueProperty().getValue(), width.ravel()
    )
    assert np.allclose(attribute(asset, "strands", "groom_color"), (0.15, 0.062, 0.025))


def test_without_strands_between_them_the_drape_itself_is_written(
    tmp_path: Path, groom: Groom, body: BodyModel
) -> None:
    clip = export_clip(groom, body, settings=ExportSettings(every=3))
    write_groom_cache(tmp_path / "hair.abc", clip)
    assert points_of(tmp_path / "hair.abc", "strands", 1).shape == (40, 24, 3)
    np.testing.assert_allclose(points_of(tmp_path / "hair.abc", "strands", 1)[..., 0], 100 * clip.strands(3)[..., 0])
    schema = curves_of(tmp_path / "hair.abc", "strands")
    assert (schema.getNumSamples(), schema.getTimeSampling().getSampleTime(1)) == (2, pytest.approx(3 / 24))
    assert check_unreal_groom.check(str(tmp_path / "hair.abc"))[0] == []


@pytest.mark.parametrize(
    ("factor", "fault"), [(1.0, ""), (0.01, "expected centimetres"), (np.nan, "NaN or infinity in frame 2")]
)
def test_the_checker_finds_faults(tmp_path: Path, clip: ExportClip, factor: float, fault: str) -> None:
    strands = clip.sequence.strands.copy()
    strands[2] *= factor
    write_groom_cache(tmp_path / "hair.abc", ExportClip(replace(clip.sequence, strands=strands)))
    faults, _ = check_unreal_groom.check(str(tmp_path / "hair.abc"), is_cache=True)
    assert bool(faults) == bool(fault)
    assert fault in " ".join(faults)


def test_the_checker_finds_what_another_exporter_gets_wrong(tmp_path: Path) -> None:
    """Another version, texture coordinates of each vertex instead of each curve, three numbers for one, no width."""
    import imath

    archive = Abc.OArchive(str(tmp_path / "other.abc"))
    schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
    Abc.OInt16Property(schema.getUserProperties(), "groom_version_major").setValue(2)
    points = imath.V3fArrayFromBuffer(np.linspace(0, 50, 12).reshape(4, 3).astype(np.float32))
    counts = imath.IntArrayFromBuffer(np.array([2, 2], np.int32))
    schema.set(AbcGeom.OCurvesSchemaSample(points, counts))
    vertex = AbcGeom.GeometryScope.kVertexScope
    uv = AbcGeom.OV2fGeomParam(schema.getArbGeomParams(), "groom_root_uv", False, vertex, 1)
    uv.set(AbcGeom.OV2fGeomParamSample(imath.V2fArrayFromBuffer(np.zeros((4, 2), np.float32)), vertex))
    uniform = AbcGeom.GeometryScope.kUniformScope
    identifier = AbcGeom.OV3iGeomParam(schema.getArbGeomParams(), "groom_id", False, uniform, 1)
    identifier.set(AbcGeom.OV3iGeomParamSample(imath.V3iArrayFromBuffer(np.zeros((2, 3), np.int32)), uniform))
    del uv, identifier, schema, archive  # the file is written as they go
    faults = "\n".join(check_unreal_groom.check(str(tmp_path / "other.abc"))[0])
    for fault in (
        "groom_version_major: expected the scalar int16 1, found kInt16POD 2",
        "no property groom_version_minor",
        "groom_root_uv: expected scope ('uni',), found 'vtx'",
        "groom_id: expected an array of ('kInt32POD',)[1], found kInt32POD[3]",
        "without groom_width its hair is 1 cm wide",
    ):
        assert fault in faults


def test_the_checker_finds_a_pair_that_does_not_fit(
    pair: tuple[Path, Path], tmp_path: Path, groom: Groom, body: BodyModel
) -> None:
    write_groom_cache(tmp_path / "other.abc", export_clip(groom, body, STRANDS, ExportSettings(points=13)))
    _, first = check_unreal_groom.check(str(pair[0]))
    _, second = check_unreal_groom.check(str(tmp_path / "other.abc"))
    assert "other numbers of points" in " ".join(check_unreal_groom.check_pair(first, second))


def test_points_and_frames_out_of_range_are_refused(tmp_path: Path) -> None:
    for settings, expected in (({"points": 256}, "2 to 255 vertices"), ({"points": 1}, "2 to"), ({"every": 0}, "1 or")):
        with pytest.raises(InputError, match=expected):
            ExportSettings(**settings)
    strands = patch_of_strands((0.0, 1.0, 0.0), vertices=300)
    with pytest.raises(InputError, match=r"at most 255 vertices a strand \(--points\), found 300"):
        write_groom_asset(tmp_path / "hair.abc", ExportClip(drape(strands)))
    write_groom_asset(tmp_path / "hair.abc", ExportClip(drape(strands), settings=ExportSettings(points=255)))
    assert check_unreal_groom.check(str(tmp_path / "hair.abc"))[0] == []


def test_the_command_writes_a_pair(tmp_path: Path, tiny_groom_file: Path) -> None:
    options = ["--draper", "posed", "--motion", "nod", "--frames", "0:3", "--strands", "50", "--points", "9"]
    main(
        ["drape", str(tiny_groom_file), *options, "--out", str(tmp_path / "nod.abc"), "--out", str(tmp_path / "n.npz")]
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["n.npz", "nod.abc", "nod_groom.abc"]
    main(["render", str(tmp_path / "n.npz"), "--strands", "50", "--points", "9", "--out", str(tmp_path / "again.abc")])
    for name in ("", "_groom"):
        one, two = (points_of(tmp_path / f"{stem}{name}.abc", "strands", 0) for stem in ("nod", "again"))
        np.testing.assert_allclose(one, two, atol=2e-3)  # cm: the groom is recovered from the drape
    assert check_unreal_groom.main([str(tmp_path / "nod_groom.abc"), str(tmp_path / "nod.abc")]) == 0


def test_a_pair_that_would_replace_a_file_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_drape(tmp_path / "d.npz", drape(patch_of_strands((0.0, 1.0, 0.0))))
    outputs = ["--out", str(tmp_path / "a.abc"), "--out", str(tmp_path / "a_groom.abc")]
    with pytest.raises(SystemExit):
        main(["render", str(tmp_path / "d.npz"), *outputs])
    assert "the same file twice" in capfd.readouterr().err
