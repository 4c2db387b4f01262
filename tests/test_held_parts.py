"""Stiffness, goals and ties of grooms: made, edited, written, read, resampled."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pxr import Sdf, Usd, UsdGeom

from quaffure import InputError
from quaffure.baselines import PosedDraper
from quaffure.body import BodyModel, Motion
from quaffure.drape_motion import drape_motion
from quaffure.energies import held_up_to, released, tied_at, with_ties
from quaffure.energies.held_parts import GOAL_STIFFNESS
from quaffure.energies.rod import BENDING_STIFFNESS, joint_lengths
from quaffure.geometry import Surface
from quaffure.hair import (
    DrapeSequence,
    ExportClip,
    ExportSettings,
    Groom,
    GuideInterpolation,
    Strands,
    concatenate_strands,
    groom_of_drape,
    register_groom,
    resample_by_arc_length,
    spread_roots,
)
from quaffure.hair.resample import resample_held_parts, without_degenerate
from quaffure.io import read_drape, read_groom, read_usd_strands, write_drape, write_groom, write_usd
from quaffure.procedural import STYLES, make_groom
from quaffure.procedural.ties import strand_bundle
from tests.synthetic_drape import drape, patch_of_strands

TIED = ("ponytail", "pigtails", "half_up", "top_knot", "low_bun", "afro_puff")
LAST = 23


@pytest.fixture(scope="module")
def tied(body: BodyModel, surface: Surface) -> dict[str, Groom]:
    return {name: make_groom(replace(STYLES[name], root_rows=16), body) for name in TIED}


# --- made by the generator --------------------------------------------------------------------------------------------


def test_every_tied_style_holds_its_hair_to_the_band_or_to_the_end(tied: dict[str, Groom]) -> None:
    assert {name for name, style in STYLES.items() if style.ties} == set(TIED)
    for name, groom in tied.items():
        assert groom.tie_vertex is not None
        held = groom.tie_vertex[groom.tie_vertex >= 0]
        share = len(held) / len(groom)
        assert 0.4 < share < 0.8 if name == "half_up" else share == 1
        assert (held == LAST).all() if name in ("top_knot", "low_bun") else (held > 2).all() & (held < 20).all()
        torch.testing.assert_close(groom.held_edges.sum(1), groom.tie_vertex.clamp(min=0))


def test_the_tie_vertex_is_in_the_band(tied: dict[str, Groom], body: BodyModel) -> None:
    groom, tie = tied["ponytail"], STYLES["ponytail"].ties[0]
    roots = spread_roots(body, 16, torch.Generator().manual_seed(0))
    centre = strand_bundle(tie, roots, body, torch.Generator()).centre
    assert groom.tie_vertex is not None
    in_band = groom.rest_strands[torch.arange(len(groom)), groom.tie_vertex]
    assert (in_band - centre).norm(dim=-1).max() < 1.5 * tie.radius
    next_to_it = groom.rest_strands[torch.arange(len(groom)), groom.tie_vertex - 2]
    assert (next_to_it - centre).norm(dim=-1).median() > 1.5 * tie.radius


def test_goals_of_a_tie_weigh_fifty_bending_stiffnesses_and_nothing_beyond(tied: dict[str, Groom]) -> None:
    groom = tied["half_up"]
    assert groom.goal_weight is not None
    expected = GOAL_STIFFNESS * BENDING_STIFFNESS / joint_lengths(groom.rest_lengths)
    torch.testing.assert_close(groom.goal_weight, expected * groom.held_edges)
    assert groom.stiffness_scale is None


def test_free_styles_hold_nothing(body: BodyModel, surface: Surface) -> None:
    groom = make_groom(replace(STYLES["bob"], root_rows=14), body)
    assert (groom.tie_vertex, groom.goal_weight, groom.stiffness_scale) == (None, None, None)
    assert not groom.held_edges.any()


def test_a_selection_keeps_the_held_parts_of_its_strands(tied: dict[str, Groom]) -> None:
    groom = replace(tied["half_up"], stiffness_scale=1 + torch.rand(len(tied["half_up"]), LAST))
    few = groom.select(torch.tensor([5, 2]))
    for name in ("stiffness_scale", "goal_weight", "tie_vertex"):
        assert torch.equal(getattr(few, name), getattr(groom, name)[[5, 2]])


# --- edited -----------------------------------------------------------------------------------------------------------


def test_hair_is_held_for_a_length_tied_at_a_length_and_released(tied: dict[str, Groom]) -> None:
    groom = replace(tied["ponytail"], tie_vertex=None, goal_weight=None)
    chosen = torch.arange(len(groom)) % 2 == 0
    arc = groom.rest_lengths.cumsum(1)
    gelled = held_up_to(groom, chosen, 0.05)
    assert gelled.tie_vertex is None
    assert not gelled.held_edges[~chosen].any()
    last = (arc * gelled.held_edges).amax(1)[chosen]
    assert (last - 0.05).abs().max() <= 0.5 * groom.rest_lengths.max() + 1e-6
    both = tied_at(gelled, ~chosen, 0.1)
    assert both.tie_vertex is not None
    assert (both.tie_vertex[chosen] == -1).all()
    assert torch.equal(both.held_edges[chosen], gelled.held_edges[chosen])
    at_tie = arc[~chosen].gather(1, both.tie_vertex[~chosen, None] - 1)
    assert (at_tie - 0.1).abs().max() <= 0.5 * groom.rest_lengths.max() + 1e-6
    assert (tied_at(groom, chosen, 2.9).tie_vertex == torch.where(chosen, LAST, -1)).all()
    free = released(both, chosen)
    assert not free.held_edges[chosen].any()
    assert torch.equal(free.held_edges[~chosen], both.held_edges[~chosen])


def test_ties_are_added_to_goals_of_an_artist(tied: dict[str, Groom]) -> None:
    groom = tied["ponytail"]
    strong = replace(groom, goal_weight=torch.full((len(groom), LAST), 1.0), tie_vertex=None)
    assert groom.tie_vertex is not None
    assert (with_ties(strong, groom.tie_vertex).goal_weight == 1).all()


# --- files ------------------------------------------------------------------------------------------------------------


def scaled(groom: Groom) -> Groom:
    scale = 1 + torch.rand(len(groom), LAST, generator=torch.Generator().manual_seed(0))
    return replace(groom, stiffness_scale=scale)


def test_groom_files_keep_held_parts(tmp_path: Path, tied: dict[str, Groom], body: BodyModel) -> None:
    groom = scaled(tied["half_up"])
    write_groom(tmp_path / "mine.npz", groom)
    again = read_groom(tmp_path / "mine.npz", body)
    for name in ("stiffness_scale", "goal_weight", "tie_vertex"):
        assert torch.equal(getattr(again, name), getattr(groom, name)), name


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as file:
        return dict(file)


def test_groom_files_of_the_first_version_are_read(tmp_path: Path, tied: dict[str, Groom], body: BodyModel) -> None:
    path, groom = tmp_path / "old.npz", tied["ponytail"]
    write_groom(path, groom)
    later = ("format_version", "goal_weight", "tie_vertex")
    np.savez(path, **{name: array for name, array in arrays_of(path).items() if name not in later})
    again = read_groom(path, body)
    assert torch.equal(again.rest_strands, groom.rest_strands)
    assert (again.tie_vertex, again.goal_weight) == (None, None)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("format_version", lambda a: np.array(3), "format version 1 to 2, found version 3"),
        ("stiffness_scale", lambda a: 0 * a, "stiffness_scale of 1 and above"),
        ("stiffness_scale", lambda a: a[:, :-1], "of shape|edges a strand"),
        ("goal_weight", lambda a: -a, "goal_weight of 0 and above"),
        ("goal_weight", lambda a: a + np.nan, "finite goal_weight"),
        ("tie_vertex", lambda a: a + 24, "a vertex of its strand"),
        ("tie_vertex", lambda a: a - 24, "a vertex of its strand"),
        ("tie_vertex", lambda a: a.astype(np.float32), "tie_vertex of type integer"),
    ],
)
def test_bad_held_parts_are_refused(
    name: str,
    change: Callable[[np.ndarray], np.ndarray],
    message: str,
    tmp_path: Path,
    tied: dict[str, Groom],
    body: BodyModel,
) -> None:
    path = tmp_path / "bad.npz"
    write_groom(path, scaled(tied["ponytail"]))
    arrays = arrays_of(path)
    np.savez(path, **{**arrays, name: change(arrays[name])})
    with pytest.raises(InputError, match=message):
        read_groom(path, body)


def held_drape() -> DrapeSequence:
    strands = patch_of_strands((0.0, 1.0, 0.0))
    random = np.random.default_rng(0)
    shape = (len(strands), strands.shape[1] - 1)
    return replace(
        drape(strands),
        stiffness_scale=1 + random.random(shape, np.float32),
        goal_weight=random.random(shape, np.float32),
        tie_vertex=random.integers(-1, 8, len(strands)),
    )


def test_drape_files_keep_held_parts(tmp_path: Path) -> None:
    write_drape(tmp_path / "drape.npz", held_drape())
    again = read_drape(tmp_path / "drape.npz")
    for name in ("stiffness_scale", "goal_weight", "tie_vertex"):
        np.testing.assert_array_equal(getattr(again, name), getattr(held_drape(), name))


def test_usd_keeps_held_parts_as_primvars(tmp_path: Path) -> None:
    path, sequence = tmp_path / "drape.usda", held_drape()
    write_usd(path, sequence)
    assert sequence.goal_weight is not None
    stage = Usd.Stage.Open(str(path))
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Drape/Hair/Strands"))
    goal, tie = primvars.GetPrimvar("quaffure:goal_weight"), primvars.GetPrimvar("quaffure:tie_vertex")
    assert (goal.GetInterpolation(), tie.GetInterpolation()) == ("vertex", "uniform")
    at_vertices = np.array(goal.Get()).reshape(len(sequence.goal_weight), 8)
    np.testing.assert_array_equal(at_vertices[:, :-1], sequence.goal_weight)
    np.testing.assert_array_equal(at_vertices[:, -1], sequence.goal_weight[:, -1])
    strands = read_usd_strands(path)
    np.testing.assert_array_equal(strands.tie_vertex, sequence.tie_vertex)
    for name in ("stiffness_scale", "goal_weight"):
        np.testing.assert_array_equal(getattr(strands, name).reshape(-1, 8)[:, :-1], getattr(sequence, name))
    write_usd(path, drape(patch_of_strands((0.0, 1.0, 0.0))))
    assert "primvars:quaffure" not in path.read_text()


def test_one_value_a_curve_stands_for_all_of_its_edges_and_others_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "curves.usda"
    for values, fits in (([2.0, 3.0], True), ([2.0, 3.0, 1.0], False)):
        stage = Usd.Stage.CreateInMemory()
        curves = UsdGeom.BasisCurves.Define(stage, "/Hair")
        curves.CreatePointsAttr([(i, 0, 0) for i in range(5)])
        curves.CreateCurveVertexCountsAttr([2, 3])
        kind = Sdf.ValueTypeNames.FloatArray
        UsdGeom.PrimvarsAPI(curves).CreatePrimvar("quaffure:stiffness_scale", kind, "uniform").Set(values)
        stage.GetRootLayer().Export(str(path))
        if fits:
            np.testing.assert_array_equal(read_usd_strands(path).stiffness_scale, [2, 2, 3, 3, 3])
        else:
            with pytest.raises(InputError, match="quaffure:stiffness_scale"):
                read_usd_strands(path)


# --- resampled, registered, interpolated ------------------------------------------------------------------------------


def bent_strands() -> Strands:
    """Two strands of uneven edges, 10 units long each: the first held and tied at 4, the second free."""
    along = np.array([0.0, 1, 4, 6, 10, 0, 2, 10])
    points = np.stack([along, 0 * along, 5 * (np.arange(8) > 4)], 1).astype(np.float32)
    return Strands(
        points,
        np.array([5, 3]),
        "test",
        stiffness_scale=np.array([1.0, 1, 3, 3, 3, 1, 2, 2]),
        goal_weight=np.array([1.0, 3, 0, 0, 0, 0, 0, 0]),
        tie_vertex=np.array([2, -1]),
    )


def test_resampling_shares_goals_out_by_length_and_moves_ties() -> None:
    strands = bent_strands()
    assert resample_by_arc_length(strands, 11)[0, 4, 0] == pytest.approx(4)
    parts = resample_held_parts(strands, 11)
    np.testing.assert_allclose(parts["goal_weight"], [[1] * 4 + [0] * 6, [0] * 10], atol=1e-6)
    np.testing.assert_allclose(parts["stiffness_scale"], [[1] * 4 + [3] * 6, [1] * 2 + [2] * 8], atol=1e-6)
    assert parts["tie_vertex"].tolist() == [4, -1]
    coarse = resample_held_parts(strands, 4)  # edges of 10 / 3: the second is held for a fifth of its length
    np.testing.assert_allclose(coarse["goal_weight"][0], [10 / 3, 0, 0], atol=1e-6)
    assert coarse["tie_vertex"].tolist() == [1, -1]
    assert resample_held_parts(replace(strands, stiffness_scale=None, goal_weight=None, tie_vertex=None), 4) == {}


def test_strands_of_any_number_of_points_have_the_goals_of_their_guide() -> None:
    """Of 100 and of 10 points; a strand off the scalp, which no guide moves, is not held."""
    counts = np.array([100, 10, 10])

    class Ragged(GuideInterpolation):
        @property
        def counts(self) -> np.ndarray:
            return counts

    strands = patch_of_strands((0.0, 1.0, 0.0))
    held = np.zeros((len(strands), strands.shape[1] - 1), np.float32)
    held[:, :3] = 2e-5
    sequence = replace(
        drape(strands), stiffness_scale=1 + 1e5 * held, goal_weight=held, tie_vertex=np.full(len(strands), 3)
    )
    nearest, corners = np.zeros((3, 3), np.int32), np.full((3, 3), 1 / 3, np.float32)
    weights = np.float32([[1, 0, 0], [1, 0, 0], [0, 0, 0]])
    between = Ragged(nearest, weights, nearest, corners, np.ones(len(strands), np.float32), 100)
    found = ExportClip(sequence, between).held_parts
    goals, stiffness = (np.split(found[name], [100, 110]) for name in ("goal_weight", "stiffness_scale"))
    # Of 99 edges, 42.4 are held, of 9 edges 3.9: the one that is held for less than a half is free.
    sums = [of_strand[:-1].sum() for of_strand in goals]
    np.testing.assert_allclose(sums, [6e-5 * 42 / (3 / 7 * 99), 6e-5, 0], rtol=1e-4)
    assert [int((of_strand[:-1] > 0).sum()) for of_strand in goals] == [42, 4, 0]
    assert (stiffness[0][0], stiffness[1][0]) == (pytest.approx(3), pytest.approx(3))
    np.testing.assert_array_equal(stiffness[2], 1)
    assert found["tie_vertex"].tolist() == [42, 4, -1]


def test_a_tie_near_the_root_of_few_points_is_at_the_first_vertex() -> None:
    sequence = drape(patch_of_strands((0.0, 1.0, 0.0)))
    clip = ExportClip(replace(sequence, tie_vertex=np.arange(len(sequence.rest_lengths)) % 3 - 1))
    few = replace(clip, settings=ExportSettings(points=3)).held_parts
    assert few["tie_vertex"][:3].tolist() == [-1, 0, 1]


def test_parts_of_a_groom_without_held_parts_ask_for_nothing() -> None:
    held = bent_strands()
    free = replace(held, stiffness_scale=None, goal_weight=None, tie_vertex=None)
    both = concatenate_strands([free, held])
    np.testing.assert_array_equal(both.tie_vertex, [-1, -1, 2, -1])
    np.testing.assert_array_equal(both.stiffness_scale, [1] * 8 + list(held.stiffness_scale))
    assert concatenate_strands([free, free]).goal_weight is None
    point = Strands(np.zeros((2, 3), np.float32), np.array([2]), "point", tie_vertex=np.array([1]))
    kept, dropped = without_degenerate(concatenate_strands([point, held]))
    assert dropped == 1
    np.testing.assert_array_equal(kept.tie_vertex, [2, -1])


def place_of_tie(groom: Groom) -> torch.Tensor:
    """Length from the root to the tie, as a share of the strand's."""
    assert groom.tie_vertex is not None
    along = groom.rest_lengths.cumsum(1) / groom.strand_lengths[:, None]
    return along.gather(1, groom.tie_vertex.clamp(min=1)[:, None] - 1)[:, 0]


def test_registration_carries_held_parts(tied: dict[str, Groom], body: BodyModel, surface: Surface) -> None:
    groom = scaled(tied["half_up"])
    flat = {name: np.pad(getattr(groom, name).numpy(), ((0, 0), (0, 1)), mode="edge").ravel() for name in
            ("stiffness_scale", "goal_weight")}  # fmt: skip
    points = 100 * groom.rest_strands.numpy().reshape(-1, 3)
    assert groom.tie_vertex is not None
    strands = Strands(points, np.full(len(groom), 24), "file", tie_vertex=groom.tie_vertex.numpy(), **flat)
    again, _ = register_groom(strands, body, "again")
    assert len(again) == len(groom)
    assert again.tie_vertex is not None
    assert torch.equal(again.tie_vertex >= 0, groom.tie_vertex >= 0)
    # Vertices of the file are not evenly spaced: the band lies between two of the new ones.
    tied_ones = groom.tie_vertex >= 0
    assert (place_of_tie(again) - place_of_tie(groom))[tied_ones].abs().max() < 0.03
    assert again.goal_weight is not None
    assert groom.goal_weight is not None
    # The new edge at the tie is held or free as a whole.
    torch.testing.assert_close(again.goal_weight.sum(1), groom.goal_weight.sum(1), rtol=0.25, atol=0)
    assert float(again.goal_weight.sum() / groom.goal_weight.sum()) == pytest.approx(1, abs=0.05)
    assert not (again.goal_weight[~tied_ones] > 0).any()


def test_drapes_and_their_grooms_carry_held_parts(tied: dict[str, Groom], body: BodyModel) -> None:
    groom = scaled(tied["half_up"])
    motion = Motion(torch.zeros(1, 81), 30.0, "still")
    sequence = drape_motion(PosedDraper(), groom, body, motion, torch.zeros(10))
    assert groom.tie_vertex is not None
    assert torch.equal(groom_of_drape(sequence, body).tie_vertex, groom.tie_vertex)
