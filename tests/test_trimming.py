import math
from dataclasses import replace

import pytest
import torch

from quaffure.body import BodyModel, load_body
from quaffure.hair import ScalpRoots, spread_roots
from quaffure.procedural import Clipping, Fringe, HairStyle
from quaffure.procedural.trimming import (
    SHORTEST,
    clipped_share,
    in_fringe,
    strand_lengths,
    trim_above,
    trim_around_ears,
    trim_below,
    trim_heights,
)

PLAIN = HairStyle(length=0.2, length_variation=0.0)


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def roots(body: BodyModel) -> ScalpRoots:
    return spread_roots(body, 24, torch.Generator().manual_seed(0))


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(1)


def test_hair_is_as_long_as_the_length_map_says(roots: ScalpRoots) -> None:
    assert torch.allclose(strand_lengths(PLAIN, roots, seeded()), torch.full((len(roots),), 0.2))
    lengths = strand_lengths(replace(PLAIN, length_map=(0.5, 1.0, 1.0, 0.1)), roots, seeded())
    forehead, nape = roots.uv[:, 1].argmin(), roots.uv[:, 1].argmax()
    assert lengths[forehead] < 0.14
    assert lengths[nape] < 0.05
    assert lengths.max() > 0.18


def test_layers_are_cut_into_the_crown_and_not_into_the_rim(roots: ScalpRoots) -> None:
    lengths = strand_lengths(replace(PLAIN, layering=0.5), roots, seeded())
    height = roots.points[:, 2]
    assert lengths[height > height.quantile(0.9)].min() < 0.12
    assert lengths[height < height.quantile(0.05)].min() > 0.17


def test_clipped_hair_is_short_and_fades_into_long_hair(roots: ScalpRoots) -> None:
    clipped = replace(PLAIN, clipping=Clipping(length=0.006, below=0.08, fade=0.02))
    share, lengths = clipped_share(clipped, roots), strand_lengths(clipped, roots, seeded())
    height = roots.from_head[:, 2]
    assert (lengths[height < 0.069] < 0.007).all()
    assert (lengths[height > 0.091] == 0.2).all()
    assert ((share > 0) & (share < 1)).any()
    strip = replace(PLAIN, clipping=Clipping(beyond=0.03, fade=0.004))
    assert (clipped_share(strip, roots) == 1).sum() == (roots.from_head[:, 0].abs() >= 0.032).sum()
    assert clipped_share(PLAIN, roots).sum() == 0


def test_a_fringe_grows_at_the_forehead_and_ends_over_the_eyes(roots: ScalpRoots) -> None:
    style = replace(PLAIN, cut_height=-0.1, fringe=Fringe(cut_height=0.055, half_width=0.05, depth=0.05))
    fringe = in_fringe(style, roots, seeded())
    assert 10 < fringe.sum() < 0.2 * len(roots)
    assert roots.from_head[fringe, 1].max() < roots.from_head[:, 1].min() + 0.05
    levels = trim_heights(style, roots, fringe, seeded()) - roots.head[2]
    assert torch.allclose(levels[fringe], torch.tensor(0.055))
    assert torch.allclose(levels[~fringe], torch.tensor(-0.1))
    assert not in_fringe(PLAIN, roots, seeded()).any()
    assert (trim_heights(PLAIN, roots, ~fringe, seeded()) == -math.inf).all()


def falling(length: float, start: tuple[float, float, float]) -> torch.Tensor:
    down = torch.linspace(0, length, 47)[:, None] * torch.tensor([0.0, 0.0, -1.0])
    return (torch.tensor(start) + down)[None]


def test_a_strand_is_cut_where_it_crosses_the_level() -> None:
    strand = falling(0.3, (0.0, 0.0, 1.0))
    cut = trim_below(strand, torch.tensor([0.8531]))
    assert cut.shape == strand.shape
    assert cut[0, -1, 2] == pytest.approx(0.8531, abs=1e-5)
    assert torch.equal(cut[0, 0], strand[0, 0])
    for below in (0.5, -math.inf):
        assert torch.allclose(trim_below(strand, torch.tensor([below])), strand, atol=1e-6)
    rising = trim_above(2 - strand, 1.2)
    assert rising[0, -1, 2] == pytest.approx(1.2, abs=1e-5)


def test_what_roots_beyond_the_cut_keeps_the_shortest_length() -> None:
    left = trim_below(falling(0.3, (0.0, 0.0, 1.0)), torch.tensor([1.1]))
    assert left.diff(dim=1).norm(dim=-1).sum() == pytest.approx(SHORTEST, rel=1e-3)


def test_hair_is_cut_round_both_ears_and_nowhere_else(body: BodyModel) -> None:
    head = body.rest_joints[body.joint_names.index("Head")]
    for side in (-1.0, 1.0):
        over = falling(0.2, (side * 0.085, 0.0, 0.1)) + head
        cut = trim_around_ears(over, head)
        assert 0.04 < float((cut[0, -1] - head)[2]) < 0.06
        behind = falling(0.2, (side * 0.07, 0.06, 0.1)) + head
        assert torch.allclose(trim_around_ears(behind, head), behind, atol=1e-6)
