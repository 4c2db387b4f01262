from dataclasses import replace

import pytest
import torch

from quaffure.body import BodyModel
from quaffure.config import VERTICES_PER_STRAND
from quaffure.geometry import Surface
from quaffure.hair import Groom, inside_share
from quaffure.procedural import CURL_TYPES, STYLES, HairStyle, curl_arc_factor, make_groom, sample_style
from quaffure.procedural.style_family import VERTICES_PER_TURN


def drawn(count: int, seed: int = 0) -> list[HairStyle]:
    generator = torch.Generator().manual_seed(seed)
    return [sample_style(generator) for _ in range(count)]


def valid(style: HairStyle, body: BodyModel, surface: Surface) -> Groom:
    groom = make_groom(style, body)
    assert groom.rest_strands.isfinite().all()
    assert groom.texels().unique().numel() == len(groom)
    assert inside_share(groom.rest_strands, surface) <= 5e-4
    assert 0.005 < groom.strand_lengths.mean() < 0.8
    assert groom.rest_lengths.min() > 5e-5
    return groom


def test_a_sample_is_a_valid_groom_of_full_size(body: BodyModel, surface: Surface) -> None:
    assert 1500 <= len(valid(drawn(1)[0], body, surface)) <= 2500


@pytest.mark.slow
def test_twenty_samples_are_valid_grooms(body: BodyModel, surface: Surface) -> None:
    for style in drawn(20, seed=1):
        valid(replace(style, root_rows=24), body, surface)


def test_the_same_seed_draws_the_same_styles_and_another_seed_others() -> None:
    assert drawn(5) == drawn(5)
    assert drawn(1) != drawn(1, seed=1)


def test_no_sample_is_a_named_style_or_another_sample() -> None:
    styles = drawn(200)
    assert len(set(styles)) == len(styles)
    assert not set(styles) & set(STYLES.values())


def test_the_family_has_every_feature_and_keeps_together_what_belongs_together() -> None:
    styles = drawn(300)
    for feature in ("fringe", "clipping", "cut_height", "parting"):
        having = sum(getattr(style, feature) is not None for style in styles)
        assert 10 < having < 290, feature
    assert 10 < sum(bool(style.ties) for style in styles) < 150
    assert {len(style.ties) for style in styles} == {0, 1, 2}
    hanging = torch.tensor([style.length / curl_arc_factor(style) for style in styles])
    assert hanging.min() < 0.03
    assert hanging.max() > 0.33
    # A curl is never finer than the vertices of a strand can show, and coils are never long.
    turn = torch.tensor([style.curl_length for style in styles]) / hanging * (VERTICES_PER_STRAND - 1)
    assert turn.min() > VERTICES_PER_TURN - 1e-3
    coiled = torch.tensor([curl_arc_factor(style) for style in styles]) > 1.9
    assert coiled.any()
    assert hanging[coiled].max() <= CURL_TYPES["curly"].hanging_length[1]
    fall = torch.tensor([style.fall for style in styles])
    assert (fall[hanging > 0.25] == 1).all()
    assert fall.min() < 0.5
