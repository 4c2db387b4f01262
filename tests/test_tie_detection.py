"""Ties found in grooms that do not name them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.hair import Groom, find_ties
from quaffure.io.read_strands import read_strands
from quaffure.procedural import STYLES, make_groom
from tests.scenes import Registered

LAST = 23


def groom_of(strands: np.ndarray) -> Groom:
    """A groom of which only the strands are real."""
    count = len(strands)
    return Groom(
        "sample",
        torch.from_numpy(strands).float(),
        torch.zeros(count, dtype=torch.long),
        torch.full((count, 3), 1 / 3),
        torch.rand(count, 2, generator=torch.Generator().manual_seed(0)),
    )


def hanging(count: int = 400) -> np.ndarray:
    """Straight strands of 30 cm from a disc of 8 cm radius, all parallel: dense, and tied by nothing."""
    random = np.random.default_rng(0)
    radius, angle = 0.08 * np.sqrt(random.random(count)), 2 * np.pi * random.random(count)
    roots = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)], 1)
    return roots[:, None] + np.linspace(0, 0.3, 24)[:, None] * np.array([0.0, 0, -1])


def through_a_ring(strands: np.ndarray, place: float = 0.1, width: float = 0.05) -> np.ndarray:
    """The strands drawn to `width` of their distance from the axis at 10 cm from the roots, and out again."""
    narrowed = 1 - (1 - width) * np.exp(-(((strands[..., 2:] + place) / 0.05) ** 2))
    return np.concatenate([narrowed * strands[..., :2], strands[..., 2:]], -1)


def test_strands_that_hang_side_by_side_are_free() -> None:
    held_to, ties = find_ties(groom_of(hanging()))
    assert (held_to == -1).all()
    assert ties == []


def test_strands_that_pass_a_ring_are_tied_there() -> None:
    held_to, (tie,) = find_ties(groom_of(through_a_ring(hanging())))
    assert tie.strands == 400
    assert not tie.wound
    assert np.linalg.norm(np.array(tie.centre) - [0, 0, -0.1]) < 0.01
    assert ((held_to >= 7) & (held_to <= 9)).all()  # vertex 7.7 is at 10 cm


def test_a_tail_that_narrows_to_its_tips_is_tied_at_its_waist() -> None:
    strands = through_a_ring(hanging())
    below = np.clip((-strands[..., 2:] - 0.15) / 0.1, 0, 1)
    strands[..., :2] *= 1 - 0.97 * below  # at its tips closer together than in the ring
    held_to, ties = find_ties(groom_of(strands))
    assert len(ties) == 1
    assert ((held_to >= 7) & (held_to <= 9)).all()


def test_a_half_narrowed_stream_is_no_tie() -> None:
    assert find_ties(groom_of(through_a_ring(hanging(), width=0.5)))[1] == []


def test_strands_that_end_in_the_ring_are_held_to_their_ends() -> None:
    strands = through_a_ring(hanging())[:, :9]
    held_to, (tie,) = find_ties(groom_of(strands))
    assert tie.strands == 400
    assert (held_to == 8).all()


def test_free_hair_beside_a_tie_stays_free() -> None:
    strands, aside = through_a_ring(hanging()), hanging(300) + np.array([0.2, 0, 0])
    held_to, ties = find_ties(groom_of(np.concatenate([aside, strands])))
    assert len(ties) == 1
    assert (held_to[:300] == -1).all()
    assert (held_to[300:] > 0).all()


def test_two_ties_are_told_apart_whatever_the_order_of_the_strands() -> None:
    strands = np.concatenate([through_a_ring(hanging()), through_a_ring(hanging(), 0.15) + np.array([0.25, 0, 0])])
    held_to, ties = find_ties(groom_of(strands))
    assert sorted(tie.strands for tie in ties) == [400, 400]
    order = np.random.default_rng(1).permutation(len(strands))
    shuffled, _ = find_ties(groom_of(strands[order]))
    assert (shuffled >= 0).all()
    assert np.abs(shuffled.numpy() - held_to.numpy()[order]).max() <= 1


def test_hair_that_ends_where_a_tail_has_its_roots_is_tied() -> None:
    """As TressFX models a ponytail: the hair of the head ends around a disc of the tail's own dense roots."""
    random = np.random.default_rng(0)
    angle = 2 * np.pi * random.random(300)
    radial = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    outer = 0.04 + 0.04 * random.random(300)
    share = np.linspace(0, 1, 24)[:, None]
    to_tail = radial[:, None] * (outer[:, None, None] * (1 - share) + 0.018 * share) + 0.01 * share * np.array(
        [0, 0, 1]
    )
    disc = 0.008 * random.standard_normal((200, 3)) * np.array([1, 1, 0])
    tail = disc[:, None] + np.linspace(0, 0.2, 24)[:, None] * np.array([0.0, 0, 1])
    loose = hanging(400) + np.array([0.3, 0, 0])
    held_to, (tie,) = find_ties(groom_of(np.concatenate([to_tail, tail, loose])))
    assert tie.strands == 300
    assert (held_to[:300] == LAST).all()
    assert (held_to[300:] == -1).all()
    assert find_ties(groom_of(np.concatenate([to_tail, loose])))[1] == []


@pytest.mark.parametrize(("style", "wound"), [("ponytail", False), ("low_bun", True), ("bob", None)])
def test_bundled_styles_with_few_strands(style: str, wound: bool | None, body: BodyModel, surface: Surface) -> None:
    groom = make_groom(replace(STYLES[style], root_rows=28), body)
    held_to, ties = find_ties(groom)
    assert [tie.wound for tie in ties] == ([] if wound is None else [wound])
    if groom.tie_vertex is not None:
        assert ((held_to >= 0) == (groom.tie_vertex >= 0)).float().mean() > 0.95
        assert (held_to - groom.tie_vertex).abs().float().mean() < 0.5


@pytest.mark.slow
@pytest.mark.shared_data
def test_the_ponytail_of_tressfx_is_found(registered: Registered, shared_data: Path) -> None:
    """The strands of `back`, which TressFX pins at both ends, end at the tail; the others hang over them."""
    parts = [f"grooms/ponytail/{part}.tfx" for part in ("back", "front_top", "side", "tail")]
    back = len(read_strands(shared_data / parts[0]))
    groom, report = registered(*parts)
    assert report.dropped == 0
    held_to, (tie,) = find_ties(groom)
    assert tie.centre[1] > 0.03
    assert (held_to[:back] == LAST).float().mean() > 0.8
    assert (held_to[back:] >= 0).float().mean() < 0.03


@pytest.mark.slow
@pytest.mark.shared_data
def test_sintel_has_no_tie(registered: Registered) -> None:
    groom, _ = registered("grooms/sintel/sintel_hair_16points.tfx", head="grooms/sintel/sintel_head.obj")
    assert find_ties(groom)[1] == []
