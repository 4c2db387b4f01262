"""`--strands original`: every strand of a groom's source on the draped ones."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.apps.cli.outputs import write_output
from quaffure.baselines import PosedDraper
from quaffure.body import BodyModel, Motion, bundled_clip, load_body
from quaffure.drape_motion import drape_motion
from quaffure.geometry import Surface
from quaffure.hair import (
    DrapeSequence,
    ExportClip,
    ExportSettings,
    Groom,
    OriginalStrands,
    PlacedStrands,
    RegistrationReport,
    StrandAttributes,
    Strands,
    distances_and_normals,
    original_strands,
    place_strands,
    polyline_lengths,
    register_groom,
    resample_by_arc_length,
)
from quaffure.hair.groom_binding import groom_binding
from quaffure.hair.resample import arc_length_places
from quaffure.io import load_source, read_source, write_groom
from quaffure.io.read_strands import read_strands
from quaffure.scene import BodyBatch, Scene
from tests.scenes import Registered
from tests.synthetic_drape import through_the_ear

pytestmark = pytest.mark.shared_data
BOW_FRAME = 40
HAIRS = 400
"""Strands of the case that are hair, the first ones; the others are a beard."""


class Case:
    """A beard and hair, of which every third strand is draped: upright, and in a bow."""

    def __init__(self, strands: Strands, groom: Groom, report: RegistrationReport, body: BodyModel) -> None:
        self.strands, self.report, self.body = strands, report, body
        self.groom = groom.select(torch.arange(0, len(groom), 3))
        self.placed = place_strands(strands, report, body)
        self.original = original_strands(self.placed, self.groom, body)
        bow = bundled_clip("bow", body).body_pose[BOW_FRAME]
        self.bodies = BodyBatch(body, torch.stack([torch.zeros(81), bow]), torch.zeros(2, 10))
        self.posed = Scene(self.groom, self.bodies).posed.numpy()
        self.vertices = self.bodies.posed.vertices.numpy()


@pytest.fixture(scope="module")
def case(registered: Registered, shared_data: Path, body: BodyModel) -> Case:
    return Case(read_strands(shared_data / "cases/beard200.hair"), *registered("cases/beard200.hair"), body)


def lengths_of(points: np.ndarray, like: PlacedStrands) -> np.ndarray:
    return np.asarray(polyline_lengths(Strands(points, like.counts, "strands")))


def hair_of(points: np.ndarray) -> np.ndarray:
    return points[: HAIRS * 24].reshape(HAIRS, 24, 3)


def settled(case: Case, frame: int) -> np.ndarray:
    """Guides that hang straight down from their posed roots, with their lengths: no drape, but as far from posed."""
    along = np.linalg.norm(np.diff(case.posed[frame], axis=1), axis=-1).cumsum(1)
    guides = np.repeat(case.posed[frame][:, :1], 24, axis=1)
    guides[:, 1:, 2] -= along
    return guides.astype(np.float32)


@pytest.mark.slow
def test_upright_the_source_comes_back(case: Case) -> None:
    found = case.original.points(case.posed[0], case.vertices[0])
    assert found.shape == case.strands.points.shape
    apart = 1e3 * np.linalg.norm(found - case.placed.points, axis=1)
    assert apart.mean() < 0.01
    assert (len(case.original), case.placed.on_scalp.sum()) == (600, 400)
    assert set(case.placed.counts[case.placed.on_scalp]) == {24}


def test_every_strand_keeps_its_length_and_leaves_the_body(case: Case) -> None:
    # Guides that hang through the shoulders are worse than any drape.
    for guides, most in ((case.posed[1], 1e-4), (settled(case, 1), 3e-3)):
        found = case.original.points(guides, case.vertices[1])
        driven = case.original.own_guide < 0
        lengths, rest = lengths_of(found, case.placed), lengths_of(case.placed.points, case.placed)
        np.testing.assert_allclose(lengths[driven], rest[driven], rtol=1e-4)
        chosen = np.repeat(driven & case.placed.on_scalp, case.placed.counts)
        chosen[case.placed.starts] = False
        surface = case.bodies.surface.samples(slice(1, 2))
        distance, _ = distances_and_normals(torch.from_numpy(found[chosen]), surface)
        assert float((distance < 0).float().mean()) < most


def test_a_strand_that_is_draped_is_its_drape(case: Case) -> None:
    """The curve of the drape, at the places along it that the source's points have along the source: these are close
    together near the root, so that no vertex of the drape is one of them."""
    placed = unevenly_spaced(case.placed)
    original = original_strands(placed, case.groom, case.body)
    guides = settled(case, 1)
    found = original.points(guides, case.vertices[1])
    own = np.flatnonzero(original.own_guide >= 0)
    assert 120 < len(own) <= len(case.groom)
    assert len(np.unique(original.own_guide[own])) == len(own)
    by_index = []
    for strand in own:
        points, rest = (
            array[placed.starts[strand] :][: placed.counts[strand]].astype(float) for array in (found, placed.points)
        )
        guide = guides[original.own_guide[strand]].astype(float)
        share = np.linalg.norm(np.diff(rest, axis=0, prepend=rest[:1]), axis=1).cumsum()
        along = 23 * share / share[-1]
        expected = np.stack([np.interp(along, np.arange(24), axis) for axis in guide.T], axis=1)
        np.testing.assert_allclose(points, expected, atol=2e-6)
        assert distance_to_polyline(points, guide).max() < 1e-6
        by_index.append(np.linalg.norm(points - guide, axis=1).max())
    assert np.median(by_index) > 5e-3


def unevenly_spaced(placed: PlacedStrands) -> PlacedStrands:
    """The strands with as many points, at distances that grow from root to tip."""
    strands = Strands(placed.points, placed.counts, "strands")
    fine = resample_by_arc_length(strands, 256)
    at = [np.rint(255 * np.linspace(0, 1, count) ** 1.5).astype(int) for count in placed.counts]
    return replace(placed, points=np.concatenate([line[chosen] for line, chosen in zip(fine, at)]))


def distance_to_polyline(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    edge = np.diff(line, axis=0)
    offset = points[:, None] - line[:-1]
    share = ((offset * edge).sum(-1) / (edge**2).sum(-1)).clip(0, 1)
    return np.asarray(np.linalg.norm(offset - share[..., None] * edge, axis=-1).min(axis=1))


def test_one_strand_of_several_at_a_root_is_the_draped_one(case: Case) -> None:
    """The one of its shape, not those that curl away from it with the same length."""
    own = np.flatnonzero(case.original.own_guide >= 0)
    first = case.placed.select(np.isin(np.arange(600), own))
    lines = first.points.reshape(len(own), 24, 3)
    away = lines[:, :1] + (lines - lines[:, :1]) * [1, -1, 1]
    points = np.concatenate([away, lines]).reshape(-1, 3).astype(np.float32)
    twice = PlacedStrands(points, *(np.tile(getattr(first, name), 2) for name in ("counts", "from_tip", "on_scalp")))
    found = original_strands(twice, case.groom, case.body).own_guide
    assert (found[: len(own)] == -1).all()
    np.testing.assert_array_equal(found[len(own) :], case.original.own_guide[own])
    # Of two that are alike, the one on the scalp.
    alike = replace(twice, points=np.concatenate([lines, lines]).reshape(-1, 3).astype(np.float32))
    alike.on_scalp[: len(own)] = False
    found = original_strands(alike, case.groom, case.body).own_guide
    np.testing.assert_array_equal(found[len(own) :], case.original.own_guide[own])


def test_upright_a_strand_that_enters_the_skin_comes_back_to_its_course(case: Case) -> None:
    """A dent towards the head behind the root: what is in the skin is pushed out, and the tip hardly moves."""
    driven = np.flatnonzero((case.original.own_guide < 0) & case.placed.on_scalp)
    points, starts = case.placed.points.copy(), case.placed.starts[driven]
    centre = case.groom.rest_strands[:, 0].mean(0).numpy()
    for start in starts:
        points[start + 1 : start + 4] += 0.15 * (centre - points[start + 1 : start + 4])
    original = original_strands(replace(case.placed, points=points), case.groom, case.body)
    found = original.points(case.posed[0], case.vertices[0])
    inside = np.linalg.norm(found[starts + 2] - points[starts + 2], axis=1)
    tips = np.linalg.norm(found[starts + 23] - points[starts + 23], axis=1)
    assert np.median(inside) > 5e-3
    assert np.median(tips) < 2e-3


def test_upright_a_strand_through_an_ear_stays_near_its_course(case: Case) -> None:
    points = through_the_ear()
    count = np.ones(1, dtype=bool)
    placed = PlacedStrands(points, np.array([len(points)]), ~count, count)
    original = original_strands(placed, case.groom, case.body)
    assert original.own_guide[0] < 0
    found = original.points(case.posed[0], case.vertices[0])
    edges = np.diff(found, axis=0)
    assert ((edges[1:] * edges[:-1]).sum(axis=1) > 0).all()
    assert np.linalg.norm(found - points, axis=1).max() < 0.015


@pytest.mark.slow
def test_registration_alone_says_where_a_strand_begins_and_stands(
    shared_data: Path, body: BodyModel, surface: Surface
) -> None:
    """A beard, hair of which some strands are stored from their tips, and some are too short to be hair."""
    whole = read_strands(shared_data / "cases/beard200.hair")
    points, starts = whole.points.copy(), whole.starts
    for strand in range(0, HAIRS, 16):
        own = slice(starts[strand], starts[strand] + whole.counts[strand])
        points[own] = points[own][::-1]
    short = np.arange(5, HAIRS, 40)
    for strand in short:
        own = slice(starts[strand], starts[strand] + whole.counts[strand])
        points[own] = points[own][:1] + 0.001 * (points[own] - points[own][:1])
    strands = replace(whole, points=points)
    groom, report = register_groom(strands, body, "mixed")
    placed = place_strands(strands, report, body)
    assert placed.from_tip.sum() == report.turned_strands == HAIRS / 16
    assert not placed.on_scalp[short].any()
    assert placed.on_scalp.sum() == report.kept == HAIRS - len(short)
    roots = placed.points[placed.starts][placed.on_scalp]
    np.testing.assert_allclose(roots, groom.rest_strands[:, 0].numpy(), atol=1e-5)
    original = original_strands(placed, groom, body)
    assert original.own_guide[placed.on_scalp].tolist() == [*range(len(groom))]


def test_the_most_similar_guide_has_the_largest_share(case: Case) -> None:
    shares = case.original.weights[case.placed.on_scalp]
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-6)
    assert (shares[:, :1] >= shares - 1e-7).all()
    assert np.median(shares[:, 0] / shares[:, 1].clip(min=1e-6)) > 1.05


def test_others_hang_as_their_guides_do(case: Case) -> None:
    """Straight hair that hangs straight down: so do the strands between, whatever their rest."""
    found = hair_of(case.original.points(settled(case, 1), case.vertices[1]))
    driven = case.original.own_guide[:HAIRS] < 0
    ends = found[driven][:, -1] - found[driven][:, 8]
    down = -ends[:, 2] / np.linalg.norm(ends, axis=1)
    assert np.median(down) > 0.98


def test_a_beard_moves_with_the_skin(case: Case) -> None:
    hairs = HAIRS * 24
    found = case.original.points(case.posed[1], case.vertices[1])[hairs:].reshape(200, -1, 3)
    rest = case.placed.points[hairs:].reshape(200, -1, 3)
    pairs = (np.linalg.norm(shape[:, :1] - shape[:, 5:], axis=-1) for shape in (found, rest))
    np.testing.assert_allclose(*pairs, atol=1e-4)
    head = case.body.joint_names.index("Head")
    turn = case.bodies.joints[1][1, head].numpy()
    edges = (found - found[:, :1]), (rest - rest[:, :1]) @ turn.T
    assert np.median(np.linalg.norm(edges[0] - edges[1], axis=-1)) < 5e-3


def test_the_order_of_the_source_is_kept(shared_data: Path, body: BodyModel, surface: Surface, case: Case) -> None:
    """Its strands, stored from the tip, of 20 vertices and of 9."""
    whole = case.strands.select(np.arange(600) < HAIRS)
    parts = [resample_by_arc_length(whole.select(np.arange(400) < 200), 20), resample_by_arc_length(whole, 9)[200:]]
    points = np.concatenate([part[:, ::-1].reshape(-1, 3) for part in parts])
    strands = Strands(points, np.repeat([20, 9], 200), "mixed")
    groom, report = register_groom(strands, body, "mixed")
    assert report.turned
    placed = place_strands(strands, report, body)
    found = original_strands(placed, groom, body)
    posed = groom.rest_strands.numpy()
    restored = found.points(posed, body.rest_vertices.numpy())
    expected = report.scale * strands.points @ report.rotation.T + report.translation
    from_root = np.concatenate([strand[::-1] for strand in np.split(expected, strands.starts[1:])])
    assert 1e3 * np.linalg.norm(restored - from_root, axis=1).mean() < 2.0
    assert found.vertex_count == 20
    assert found.strands(posed, body.rest_vertices.numpy()).shape == (400, 20, 3)
    with pytest.raises(InputError, match="finite guides"):
        found.points(np.full_like(posed, np.nan), body.rest_vertices.numpy())
    with pytest.raises(InputError, match="guides"):
        found.points(posed[1:], body.rest_vertices.numpy())


def test_groom_files_keep_the_source(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "groom.npz"
    write_groom(path, case.groom, case.placed)
    found = read_source(path)
    assert found is not None
    for name in ("points", "counts", "from_tip", "on_scalp"):
        np.testing.assert_array_equal(getattr(found, name), getattr(case.placed, name))
    write_groom(path, case.groom)
    assert read_source(path) is None
    with pytest.raises(InputError, match="a groom file without its source"):
        load_source(path, case.body)
    with pytest.raises(InputError, match="a bundled groom"):
        load_source("bob", case.body)
    write_groom(path, case.groom, case.placed)
    arrays = dict(np.load(path))
    arrays["source_counts"][0] = -5
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="source_counts of 2 and more"):
        read_source(path)


def assert_normals_lead_away(path: Path, points: np.ndarray, counts: np.ndarray) -> None:
    """Of a .bin file: unit vectors, y up, from the middle of all roots."""
    numbers = np.fromfile(path, "<f4")[1:]
    heads = 7 * (np.cumsum(counts) - counts) + np.arange(len(counts))
    normals = np.delete(numbers, heads).reshape(-1, 7)[:, 3:6]
    x, y, z = (points - points[np.cumsum(counts) - counts].mean(axis=0)).T
    away = np.stack([x, z, -y], axis=1)
    np.testing.assert_allclose(normals, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-4)


@pytest.mark.parametrize("suffix", [".usda", ".abc", ".hair", ".ply", ".data", ".bin"])
def test_every_format_keeps_what_the_source_says(case: Case, tmp_path: Path, suffix: str) -> None:
    """Points a strand, widths, colours, ids, groups and root coordinates, in the order of the source."""
    pytest.importorskip({".usda": "pxr", ".abc": "alembic3d"}.get(suffix, "numpy"))
    strands = PlacedStrands(*(getattr(case.placed, name) for name in ("points", "counts", "from_tip", "on_scalp")))
    count, random = len(strands), np.random.default_rng(0)
    given = StrandAttributes(
        width=random.uniform(5e-5, 2e-4, len(strands.points)),
        colour=random.uniform(0, 1, (len(strands.points), 3)),
        identifier=random.permutation(5000)[:count],
        group=(np.arange(count) % 2).astype(np.int64),
        root_uv=random.uniform(0, 1, (count, 2)),
        group_names=("left", "right"),
    )
    original = original_strands(replace(strands, attributes=given), case.groom, case.body)
    sequence = still(case)
    path = tmp_path / f"hair{suffix}"
    write_output(path, ExportClip(sequence, original))
    found = read_strands(path)
    assert len(set(strands.counts)) > 1
    np.testing.assert_array_equal(found.counts, strands.counts)
    metres = np.linalg.norm(np.ptp(strands.points, axis=0)) / np.linalg.norm(np.ptp(found.points, axis=0))
    assert metres == pytest.approx({".abc": 0.01, ".bin": 0.001}.get(suffix, 1.0), rel=1e-4)
    if suffix in (".data", ".bin"):
        x, y, z = (0.001 if suffix == ".bin" else 1.0) * found.points.T
        points = ExportClip(sequence, original).points(0)
        np.testing.assert_allclose(np.stack([x, -z, y], axis=1), points, atol=1e-6)
        if suffix == ".bin":
            np.testing.assert_array_equal(found.attributes.group, given.group)
            assert found.attributes.group_names == ("label/0", "label/1")
            assert_normals_lead_away(path, points, strands.counts)
        return
    np.testing.assert_allclose(metres * found.attributes.width, given.width, rtol=1e-5)
    np.testing.assert_allclose(found.attributes.colour, given.colour, rtol=1e-6)
    if suffix != ".hair":
        np.testing.assert_array_equal(found.attributes.identifier, given.identifier)
        np.testing.assert_allclose(found.attributes.root_uv, given.root_uv, rtol=1e-5)
        np.testing.assert_array_equal(found.attributes.group, given.group)
        names = ("group/0", "group/1") if suffix == ".ply" else given.group_names
        assert found.attributes.group_names == names


@pytest.mark.parametrize("suffix", [".usda", ".abc"])
def test_guides_have_the_root_coordinates_of_their_strands(case: Case, tmp_path: Path, suffix: str) -> None:
    """Those of the source's layout, as the strands: two layouts in one file would be of no use."""
    pytest.importorskip({".usda": "pxr", ".abc": "alembic3d"}[suffix])
    count = len(case.placed)
    given = StrandAttributes(root_uv=np.stack([np.arange(count), -np.arange(count)], axis=1) / count)
    original = original_strands(replace(case.placed, attributes=given), case.groom, case.body)
    binding = groom_binding(case.groom, case.body, torch.zeros(10))
    clip = ExportClip(still(case), original, binding, ExportSettings(guides=True))
    assert clip.guide_root_uv is not None
    own = np.flatnonzero(original.own_guide >= 0)
    np.testing.assert_allclose(clip.guide_root_uv[original.own_guide[own]], given.root_uv[own], rtol=1e-6)
    write_output(tmp_path / f"hair{suffix}", clip)
    without = original_strands(case.placed, case.groom, case.body)
    plain = ExportClip(still(case), without, binding)
    np.testing.assert_array_equal(plain.guide_root_uv, binding.root_uv)


@pytest.fixture(scope="module")
def ramps(case: Case) -> OriginalStrands:
    """Strands whose widths and colours grow evenly along them, with the ids that half of them have."""
    placed, count = case.placed, len(case.placed)
    strands = Strands(placed.points, placed.counts, "ramps")
    right, weight = arc_length_places(strands, 3)
    assert len(set(placed.counts)) > 1
    assert right.shape == weight.shape == (count, 3)
    steps = np.linalg.norm(np.diff(placed.points, axis=0, prepend=placed.points[:1]), axis=1)
    steps[placed.starts] = 0
    along = np.cumsum(steps) - np.repeat(np.cumsum(steps)[placed.starts], placed.counts)
    along = (along / np.repeat(polyline_lengths(strands), placed.counts)).clip(0, 1)
    given = StrandAttributes(
        width=1e-4 * (2 - along),
        colour=np.stack([along, 1 - along, np.full(len(along), 0.5)], axis=1),
        identifier=np.where(np.arange(count) % 2, -1, np.arange(count)),
    )
    return original_strands(replace(placed, attributes=given), case.groom, case.body)


@pytest.mark.parametrize("points", [5, 40])
def test_resampled_strands_keep_widths_and_colours(case: Case, ramps: OriginalStrands, points: int) -> None:
    clip = ExportClip(still(case), ramps, settings=ExportSettings(points=points))
    even = np.tile(np.linspace(0, 1, points), len(ramps))
    np.testing.assert_allclose(clip.widths, 1e-4 * (2 - even), rtol=0.02)
    np.testing.assert_allclose(clip.colours, np.stack([even, 1 - even, np.full(len(even), 0.5)], axis=1), atol=0.02)
    ends = clip.points(0).reshape(-1, points, 3)[:, [0, -1]]
    own = ramps.points(case.posed[0], case.vertices[0])
    starts, last = ramps.placed.starts, np.cumsum(ramps.counts) - 1
    np.testing.assert_array_equal(ends, np.stack([own[starts], own[last]], axis=1))


def test_guides_and_ids_of_all_strands_are_valid(case: Case, ramps: OriginalStrands) -> None:
    """A beard's strands, which no guide moves, name their nearest guide; strands without ids get further ones."""
    clip = ExportClip(still(case), ramps)
    guides, weights = clip.closest_guides
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
    off = ~ramps.placed.on_scalp
    assert off.sum() == 200
    assert (weights[off] == [1, 0, 0]).all()
    assert (ramps.weights[off] == 0).all()  # the drape still leaves them to the skin
    assert 0 <= guides.min() <= guides.max() < len(case.groom)
    identifiers = clip.identifiers
    assert identifiers is not None
    assert identifiers[::2].tolist() == [*range(0, 600, 2)]
    assert identifiers[1::2].tolist() == [*range(599, 899)]
    assert clip.guide_identifiers.tolist() == [*range(1, 2 * len(case.groom), 2)]
    none = replace(ramps.placed, attributes=StrandAttributes(identifier=np.full(600, -1)))
    assert ExportClip(still(case), replace(ramps, placed=none)).identifiers is None


def test_unreals_schema_finds_no_fault_in_a_source(case: Case, ramps: OriginalStrands, tmp_path: Path) -> None:
    """Ids of the file, and others of guides, which the strands name by their ids; in USD, too."""
    pytest.importorskip("alembic3d")
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    from scripts import check_unreal_groom

    clip = ExportClip(still(case), ramps, settings=ExportSettings(guides=True))
    write_output(tmp_path / "hair.abc", clip)
    faults, found = check_unreal_groom.check(str(tmp_path / "hair_groom.abc"))
    assert faults == []
    assert len(found) == 2
    write_output(tmp_path / "hair.usda", clip)
    stage = Usd.Stage.Open(str(tmp_path / "hair.usda"))
    strands, guides = (
        UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(f"/Drape/Hair/{name}")) for name in ("Strands", "Guides")
    )
    closest = np.array(strands.GetPrimvar("groom_closest_guides").Get())
    assert {*closest.ravel()} <= {*guides.GetPrimvar("groom_id").Get()}


def test_usd_shows_the_colours_of_the_source(case: Case, ramps: OriginalStrands, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdShade, UsdValidation

    write_output(tmp_path / "hair.usda", ExportClip(still(case), ramps))
    stage = Usd.Stage.Open(str(tmp_path / "hair.usda"))
    curves = UsdGeom.BasisCurves.Get(stage, "/Drape/Hair/Strands")
    shown = curves.GetDisplayColorPrimvar()
    assert shown.GetInterpolation() == "vertex"
    np.testing.assert_allclose(np.array(shown.Get()), ramps.attributes.colour, rtol=1e-6)
    material, _ = UsdShade.MaterialBindingAPI(curves).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0]
    reader = UsdShade.Shader(surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source)
    assert (reader.GetShaderId(), reader.GetInput("varname").Get()) == ("UsdPrimvarReader_float3", "displayColor")
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in found] == []


@pytest.mark.parametrize("mesh", ["ribbons", "tubes"])
def test_gltf_has_the_points_widths_and_colours_of_the_source(
    case: Case, ramps: OriginalStrands, tmp_path: Path, mesh: Literal["ribbons", "tubes"]
) -> None:
    trimesh = pytest.importorskip("trimesh")
    write_output(tmp_path / "hair.glb", ExportClip(still(case), ramps, settings=ExportSettings(mesh=mesh)))
    hair = trimesh.load(tmp_path / "hair.glb", process=False).geometry["Hair"]
    around = 2 if mesh == "ribbons" else 3
    assert len(hair.vertices) == around * len(ramps.placed.points)
    corners = np.asarray(hair.vertices).reshape(-1, around, 3)
    middles = corners.mean(axis=1)
    x, y, z = ramps.points(case.posed[0], case.vertices[0]).T
    np.testing.assert_allclose(middles, np.stack([x, z, -y], axis=1), atol=1e-6)
    radius = np.linalg.norm(corners - middles[:, None], axis=2)
    np.testing.assert_allclose(2 * radius, np.tile(ramps.attributes.width, (around, 1)).T, atol=1e-6)
    content = (tmp_path / "hair.glb").read_bytes()
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    accessor = document["accessors"][document["meshes"][1]["primitives"][0]["attributes"]["COLOR_0"]]
    start = (
        28 + int.from_bytes(content[12:16], "little") + document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    )
    colours = np.frombuffer(content, "<f4", 3 * accessor["count"], start).reshape(-1, around, 3)
    np.testing.assert_allclose(colours, np.repeat(ramps.attributes.colour[:, None], around, axis=1), rtol=1e-6)
    assert document["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]


def test_a_strand_without_a_length_does_not_end_an_export(case: Case, tmp_path: Path) -> None:
    points = case.placed.points.copy()
    points[: case.placed.counts[0]] = points[0]
    original = original_strands(replace(case.placed, points=points), case.groom, case.body)
    clip = ExportClip(still(case), original, settings=ExportSettings(points=7))
    assert np.ptp(clip.points(0).reshape(-1, 7, 3)[0], axis=0).max() < 1e-6
    assert np.isfinite(clip.points(0)).all()
    assert np.isfinite(original.strands(case.posed[0], case.vertices[0])).all()
    write_output(tmp_path / "hair.glb", clip)


def test_groups_without_names_in_a_groom_file_are_refused(case: Case, tmp_path: Path) -> None:
    given = StrandAttributes(group=np.full(600, 2), group_names=("left", "right"))
    write_groom(tmp_path / "groom.npz", case.groom, replace(case.placed, attributes=given))
    with pytest.raises(InputError, match="source_group from -1 to 1"):
        read_source(tmp_path / "groom.npz")


def test_strands_without_a_group_are_in_one_of_their_own(case: Case) -> None:
    group = np.zeros(len(case.placed.counts), np.int64)
    group[1], group[2] = 1, -1
    placed = replace(case.placed, attributes=StrandAttributes(group=group, group_names=("left", "right")))
    clip = ExportClip(still(case), original_strands(placed, case.groom, case.body))
    assert clip.group_names == ("left", "right", case.groom.name)
    assert clip.groups[:4].tolist() == [0, 1, 2, 0]


def still(case: Case) -> DrapeSequence:
    """A drape of the rest pose, in one frame."""
    motion = Motion(torch.zeros(1, 81), 30.0, "still")
    return drape_motion(PosedDraper(), case.groom, case.body, motion, torch.zeros(10))


@pytest.fixture(scope="module")
def imported(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The case as `quaffure groom import` writes it."""
    path = tmp_path_factory.mktemp("imported") / "mine.npz"
    main(["groom", "import", str(shared_data / "cases/beard200.hair"), "--ties", "none", "--out", str(path)])
    return path


@pytest.mark.slow
def test_the_command_writes_the_source(
    imported: Path, shared_data: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pxr")
    groom, out = tmp_path / "mine.npz", tmp_path / "drape.usda"
    command = ["drape", str(imported), "--draper", "posed", "--frames", "0"]
    main([*command, "--strands", "original", "--out", str(out)])
    # Guides are written besides, and left out by the reader.
    assert len(read_strands(out)) == 600
    main(["groom", "import", str(shared_data / "cases/beard200.hair"), "--parts", "drop", "--out", str(groom)])
    assert len(load_source(groom, load_body())) == 400
    with pytest.raises(SystemExit):
        main([*command, "--strands", "some", "--out", str(out)])
    assert "a number of strands, original or guides" in capfd.readouterr().err


@pytest.mark.slow
def test_render_shows_the_source_of_a_drape_file(
    imported: Path, shared_data: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    groom, other, drape = imported, tmp_path / "other.npz", tmp_path / "drape.npz"
    main(["groom", "import", str(shared_data / "cases/cap60_other_head.hair"), "--out", str(other)])
    out = [str(tmp_path / f"{name}.hair") for name in ("drape", "render")]
    shown = ["--strands", "original"]
    main(["drape", str(groom), "--draper", "posed", "--frames", "0", *shown, "--out", str(drape), "--out", out[0]])
    render = ["render", str(drape), *shown, "--out", out[1]]
    main([*render, "--groom", str(groom)])
    assert Path(out[0]).read_bytes() == Path(out[1]).read_bytes()
    for options, message in (
        ([], "--groom: expected the groom file"),
        (["--groom", str(other)], "the groom of the drape"),
    ):
        with pytest.raises(SystemExit):
            main([*render, *options])
        assert message in capfd.readouterr().err
