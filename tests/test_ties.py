from dataclasses import replace

import pytest
import torch

from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.hair import Groom, ScalpRoots, spread_roots
from quaffure.procedural import STYLES, HairStyle, make_groom
from quaffure.procedural.curls import clumped, curled
from quaffure.procedural.generator import STEPS
from quaffure.procedural.ties import strand_bundle, tie_of_strand, trace_tied


@pytest.fixture(scope="module")
def roots(body: BodyModel) -> ScalpRoots:
    return spread_roots(body, 20, torch.Generator().manual_seed(0))


def sample_groom(style: HairStyle, body: BodyModel) -> Groom:
    return make_groom(replace(style, root_rows=20), body)


def to_band(groom: Groom, style: HairStyle, body: BodyModel, roots: ScalpRoots) -> torch.Tensor:
    """Distance of every strand from the middle of the first tie's band [m]."""
    middle = strand_bundle(style.ties[0], roots, body, torch.Generator()).centre
    return (groom.rest_strands - middle).norm(dim=-1).amin(1)


def test_every_strand_of_a_ponytail_passes_the_band_and_hangs(body: BodyModel, roots: ScalpRoots) -> None:
    style = STYLES["ponytail"]
    groom = sample_groom(style, body)
    band = style.ties[0].radius
    assert torch.quantile(to_band(groom, style, body, roots), 0.98) < 1.5 * band
    tips = groom.rest_strands[:, -1]
    assert tips[:, 2].max() < groom.rest_strands[:, 0, 2].min() + 0.05
    assert tips[:, 0].abs().max() < 0.08


def test_strands_enter_the_band_from_the_side_that_they_come_from(body: BodyModel, roots: ScalpRoots) -> None:
    bundle = strand_bundle(STYLES["ponytail"].ties[0], roots, body, torch.Generator().manual_seed(0))
    aside = roots.points[:, 0].abs() > 0.03
    assert (bundle.crossings[aside, 0] * roots.points[aside, 0] > 0).all()
    assert torch.allclose(bundle.radial @ bundle.axis, torch.zeros(len(roots)), atol=1e-5)


def test_the_returned_index_is_the_vertex_in_the_band(body: BodyModel, surface: Surface, roots: ScalpRoots) -> None:
    for name in ("ponytail", "top_knot"):
        style = STYLES[name]
        generator = torch.Generator().manual_seed(0)
        bundle = strand_bundle(style.ties[0], roots, body, generator)
        axes, in_band = trace_tied(style, style.ties[0], bundle, STEPS, surface, generator)
        assert axes.shape == (len(roots), STEPS + 1, 3)
        assert torch.allclose(axes[:, in_band], bundle.crossings, atol=1e-6)
        assert torch.equal(axes[:, 0], roots.points)


def test_pigtails_go_to_their_own_side(body: BodyModel, roots: ScalpRoots) -> None:
    ties = tie_of_strand(STYLES["pigtails"], roots)
    assert (ties[roots.points[:, 0] > 1e-3] == 0).all()
    assert (ties[roots.points[:, 0] < -1e-3] == 1).all()
    strands = sample_groom(STYLES["pigtails"], body).rest_strands
    aside = strands[:, 0, 0].abs() > 1e-3
    assert (strands[aside, -1, 0] * strands[aside, 0, 0] > 0).all()


def test_half_up_ties_hair_above_a_height_only(roots: ScalpRoots) -> None:
    tied = tie_of_strand(STYLES["half_up"], roots) >= 0
    height = roots.from_head[:, 2]
    assert tied[height > 0.12].all()
    assert not tied[height < 0.01].any()
    assert 0.3 < tied.float().mean() < 0.8


def test_a_bun_is_a_ball_round_its_tie_and_a_puff_is_a_larger_one(body: BodyModel, roots: ScalpRoots) -> None:
    style = STYLES["top_knot"]
    radius = style.ties[0].bun_radius
    assert radius is not None
    beyond = sample_groom(style, body).rest_strands[:, -8:]
    middle = strand_bundle(style.ties[0], roots, body, torch.Generator()).centre
    assert (beyond - middle).norm(dim=-1).max() < 2 * radius
    puff = sample_groom(STYLES["afro_puff"], body).rest_strands[:, -1]
    band = strand_bundle(STYLES["afro_puff"].ties[0], roots, body, torch.Generator()).centre
    spread = (puff - band).norm(dim=-1)
    assert 0.05 < spread.mean() < 0.15
    assert (puff - puff.mean(0)).std(0).min() > 0.02  # a ball, not a disc


def test_curls_and_clumps_begin_behind_the_band() -> None:
    axes = torch.linspace(0, 0.3, 47)[None, :, None] * torch.tensor([0.0, 0.0, -1.0])
    axes = axes + torch.tensor([[[0.0, 0.0, 0.0]], [[0.01, 0.0, 0.0]]])
    tied, style = torch.tensor([0.1, 0.1]), HairStyle(curl_radius=0.01, frizz=0.01, clumping=0.8, curl_start=0.01)
    before = torch.linspace(0, 0.3, 47) <= 0.1
    normals = torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3)
    for bent in (clumped(style, axes, tied), curled(style, axes, normals, tied, torch.Generator().manual_seed(0))):
        moved = (bent - axes).norm(dim=-1).amax(0)
        assert moved[before].max() < 1e-6
        assert moved[-5:].min() > 3e-3
