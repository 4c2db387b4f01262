import math
from dataclasses import replace

import pytest
import torch

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.geometry.polyline import arc_lengths
from quaffure.hair import Groom, distances_and_normals, inside_share, pushed_out, root_positions
from quaffure.hair.clearance import CLEARANCE, CLEARANCE_RAMP, pushed_out_smoothly
from quaffure.procedural import HELD_OUT, STYLES, curl_arc_factor, make_groom
from quaffure.procedural.generator import resample_evenly, vertex_in_band
from tests.synthetic_drape import through_the_ear

FEW = {
    "long_straight", "long_wavy", "bob", "bob_fringe", "slicked_back", "short_curly", "short_coils", "undercut",
    "crew_cut", "afro", "ponytail", "low_bun",
}  # fmt: skip
EVERY_STYLE = [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in sorted(STYLES)]


@pytest.fixture(scope="module")
def grooms(body: BodyModel, surface: Surface) -> dict[str, Groom]:
    return {name: make_groom(name, body) for name in sorted(FEW)}


def test_there_are_many_styles_and_some_are_held_out() -> None:
    assert len(STYLES) >= 24
    assert len(set(STYLES.values())) == len(STYLES)
    assert len(set(HELD_OUT)) == 3
    assert set(HELD_OUT) < set(STYLES)
    assert "long_straight" not in HELD_OUT  # the shipped network has seen it


@pytest.mark.parametrize("name", EVERY_STYLE)
def test_strands_stand_on_the_scalp_and_outside_the_body(name: str, body: BodyModel, surface: Surface) -> None:
    groom = make_groom(name, body)
    assert 1500 <= len(groom) <= 2500
    assert groom.rest_strands.shape[1:] == (24, 3)
    assert groom.texels().unique().numel() == len(groom)
    assert torch.isin(groom.root_faces, body.scalp.faces).all()
    roots = root_positions(groom, body.rest_vertices[None], body)[0]
    assert torch.allclose(groom.rest_strands[:, 0], roots, atol=1e-6)
    assert torch.allclose(body.scalp.uv_at(groom.root_faces, groom.root_barycentric), groom.root_uv)
    distance, _ = distances_and_normals(groom.rest_strands[:, 1:], surface)
    assert (distance < 0).float().mean() <= 5e-4
    # Hair that is long enough has reached the full clearance.
    far = arc_lengths(groom.rest_strands)[:, 1:] > 1.5 * CLEARANCE / CLEARANCE_RAMP
    if far.any():
        assert torch.quantile(distance[far][::7], 0.01) > 0.8 * CLEARANCE


@pytest.mark.parametrize("name", EVERY_STYLE)
def test_no_hair_hangs_before_eyes_nose_and_mouth(name: str, body: BodyModel) -> None:
    head = body.rest_joints[body.joint_names.index("Head")]
    x, y, z = (make_groom(name, body).rest_strands - head).unbind(-1)
    in_face = (x.abs() < 0.035) & (y < -0.08) & (z > -0.07) & (z < 0.045)
    assert in_face.float().mean() < 2e-3


def test_no_hair_passes_through_an_ear_between_its_vertices(grooms: dict[str, Groom], surface: Surface) -> None:
    share = torch.linspace(0, 1, 5)[1:-1, None]
    for name in ("long_straight", "bob_fringe", "slicked_back", "ponytail", "short_coils", "undercut"):
        strands = grooms[name].rest_strands
        between = strands[:, :-1, None] * (1 - share) + strands[:, 1:, None] * share
        assert inside_share(between.flatten(1, 2), surface) <= 5e-4, name


@pytest.mark.parametrize("name", EVERY_STYLE)
def test_the_scalp_is_covered_evenly(name: str, body: BodyModel) -> None:
    roots = make_groom(name, body).rest_strands[::, 0]
    spacing = torch.cdist(roots, roots).topk(2, largest=False).values[:, 1]
    assert spacing.max() < 2.5 * spacing.median()
    assert abs(float(roots[:, 0].mean())) < 2e-3  # as many on the left as on the right


@pytest.mark.parametrize("name", EVERY_STYLE)
def test_edges_are_even(name: str, body: BodyModel) -> None:
    lengths = make_groom(name, body).rest_lengths
    assert torch.quantile(lengths.amin(1) / lengths.mean(1), 0.01) > 0.4
    assert lengths.min() > 1e-4


@pytest.mark.parametrize(
    ("name", "shortest", "longest"),
    [
        ("long_straight", 0.33, 0.40),
        ("long_wavy", 0.33, 0.45),
        ("bob", 0.13, 0.26),
        ("short_curly", 0.05, 0.14),
        ("crew_cut", 0.01, 0.03),
        ("ponytail", 0.38, 0.50),
    ],
)
def test_lengths_are_those_of_the_styles(name: str, shortest: float, longest: float, grooms: dict[str, Groom]) -> None:
    assert shortest < grooms[name].strand_lengths.median() < longest


def test_long_hair_hangs_and_parts(grooms: dict[str, Groom]) -> None:
    strands = grooms["long_straight"].rest_strands
    assert (strands[:, -1, 2] < strands[:, 0, 2]).all()
    front = strands[strands[:, 0, 1] < -0.11]
    left = front[:, 0, 0] > 0.005
    right = front[:, 0, 0] < -0.005
    assert (front[left, -1, 0] > 0.03).all()
    assert (front[right, -1, 0] < -0.03).all()


def test_long_hair_passes_the_shoulders_and_does_not_lie_out_along_them(grooms: dict[str, Groom]) -> None:
    tips = grooms["long_straight"].rest_strands[:, -1]
    assert torch.quantile(tips[:, 0].abs(), 0.99) < 0.14


def test_curls_wind(grooms: dict[str, Groom]) -> None:
    """The way from root to tip is much shorter than a curly strand, and nearly as long as a straight one."""

    def stretch(groom: Groom) -> float:
        ends = (groom.rest_strands[:, -1] - groom.rest_strands[:, 0]).norm(dim=1)
        return float((ends / groom.strand_lengths).median())

    assert stretch(grooms["short_curly"]) < 0.65
    assert stretch(grooms["bob"]) > 0.75


def test_a_turn_of_a_curl_takes_enough_vertices_to_show() -> None:
    for name, style in STYLES.items():
        if style.curl_radius > 0 and not style.ties:
            assert 23 * style.curl_length / (style.length / curl_arc_factor(style)) > 4.5, name


def test_the_same_seed_gives_the_same_groom(body: BodyModel, surface: Surface, grooms: dict[str, Groom]) -> None:
    again = make_groom.__wrapped__("bob", body, seed=0)  # made anew
    assert torch.equal(again.rest_strands, grooms["bob"].rest_strands)
    small = replace(STYLES["bob"], root_rows=12)
    first, other = (make_groom(small, body, seed=seed).root_uv for seed in (0, 1))
    assert first.shape != other.shape or not torch.equal(first, other)


def test_controls_do_what_they_say(body: BodyModel, surface: Surface) -> None:
    plain = replace(STYLES["bob"], root_rows=20, cut_height=None)
    short, long = (make_groom(replace(plain, length=length), body) for length in (0.1, 0.2))
    assert torch.isclose(long.strand_lengths.median() / short.strand_lengths.median(), torch.tensor(2.0), rtol=0.1)
    assert short.name == "procedural"
    flat, up = (make_groom(replace(plain, fall=fall), body) for fall in (1.0, 0.0))
    assert up.rest_strands[:, -1, 2].mean() > flat.rest_strands[:, -1, 2].mean() + 0.05
    right, left = (make_groom(replace(plain, parting=None, sideways=way, length=0.08), body) for way in (-2.0, 2.0))
    top = left.rest_strands[:, 0, 2] > left.rest_strands[:, 0, 2].max() - 0.03
    way = (left.rest_strands - right.rest_strands)[top, -1, 0]
    assert way.mean() > 0.05


def test_held_hair_lies_closer_to_the_head(body: BodyModel, surface: Surface) -> None:
    slick = replace(STYLES["slicked_back"], root_rows=20, cut_around_ears=False)
    loose = replace(slick, hold=0.0, fall=0.0)
    near, far = (
        distances_and_normals(make_groom(style, body).rest_strands, surface)[0].mean() for style in (slick, loose)
    )
    assert near < 0.012
    assert far > 2 * near


def test_evenly_keeps_a_vertex_in_the_band() -> None:
    """A corner at a fifth of a bent polyline is met exactly where it is a band, and cut off where it is not."""
    leg = torch.linspace(0, 1, 11)[:, None]
    across = torch.cat([leg * torch.tensor([0.053, 0.0, 0.0]), leg[1:] * torch.tensor([0.0, 0.2, 0.0])])
    across[11:, 0] = 0.053
    corner = torch.tensor([0.053, 0.0, 0.0])
    fine = across[None]
    lengths = (torch.tensor([length]) for length in (0.053, 0.0))
    tied, free = (resample_evenly(fine, length, vertex_in_band(fine, length))[0] for length in lengths)
    assert (tied - corner).norm(dim=1).min() < 1e-6
    assert (free - corner).norm(dim=1).min() > 1e-3
    for strand in (tied, free):
        assert torch.allclose(strand[[0, -1]], across[[0, -1]])


def test_unknown_styles_are_refused(body: BodyModel) -> None:
    with pytest.raises(InputError, match="bob"):
        make_groom("beehive", body)


def test_a_strand_through_an_ear_is_not_caught_above_it(surface: Surface) -> None:
    outwards = torch.tensor([7e-3, 0.0, 0.0])
    strand = torch.from_numpy(through_the_ear())[None] + outwards
    assert float(distances_and_normals(strand, surface)[0].min()) < -2e-3
    found = pushed_out(strand, surface)
    edges = torch.nn.functional.normalize(found[0].diff(dim=0), dim=-1)
    assert float((edges[1:] * edges[:-1]).sum(-1).min()) > 0
    lengths = (float(strands.diff(dim=1).norm(dim=-1).sum()) for strands in (strand, found))
    assert next(lengths) == pytest.approx(next(lengths), rel=0.03)
    assert float((found - strand).norm(dim=-1).max()) < 0.015
    assert inside_share(found, surface) == 0


def test_pushed_out_keeps_roots_and_lengths(grooms: dict[str, Groom], body: BodyModel, surface: Surface) -> None:
    strands = grooms["long_straight"].rest_strands[::10].clone()
    head = body.rest_joints[body.joint_names.index("Head")]
    pressed = strands.clone()
    pressed[:, 1:] += 0.12 * (head - strands[:, 1:]).clamp(-0.2, 0.2)
    before = inside_share(pressed, surface)
    assert inside_share(pressed.clone().requires_grad_(), surface) == before
    result = pushed_out(pressed, surface)
    assert before > 0.05
    assert inside_share(result, surface) <= 5e-4
    assert torch.equal(result[:, 0], pressed[:, 0])
    lengths, kept = (s.diff(dim=1).norm(dim=-1).sum(1) for s in (pressed, result))
    assert torch.quantile((kept / lengths - 1).abs(), 0.98) < 0.01


def test_pushed_out_smoothly_leaves_few_zigzags(body: BodyModel, surface: Surface) -> None:
    """Hair of the back that is moved forward by 4 cm, into head and neck."""
    strands = make_groom("long_straight", body).rest_strands[::4]
    pressed = strands.clone()
    pressed[:, 1:, 1] -= 0.04
    assert inside_share(pressed, surface) > 0.05
    jagged, smooth = pushed_out(pressed, surface), pushed_out_smoothly(pressed, surface)
    assert _zigzags(pressed) == 0
    assert _zigzags(jagged) > 10
    assert _zigzags(smooth) < 0.2 * _zigzags(jagged)
    assert inside_share(smooth, surface) <= 5e-4
    assert torch.equal(smooth[:, 0], pressed[:, 0])
    lengths, kept = (shape.diff(dim=1).norm(dim=-1).sum(1) for shape in (pressed, smooth))
    assert torch.quantile((kept / lengths - 1).abs(), 0.98) < 0.01
    untouched = (jagged == pressed).all(dim=(1, 2))
    assert untouched.any()
    assert torch.equal(smooth[untouched], pressed[untouched])


def _zigzags(strands: torch.Tensor) -> int:
    """Strands that bend by more than 20 degrees at a vertex, and at the next one by as much the other way."""
    edges = torch.nn.functional.normalize(strands.diff(dim=1), dim=-1)
    bends = torch.linalg.cross(edges[:, :-1], edges[:, 1:])
    sharp = (edges[:, :-1] * edges[:, 1:]).sum(-1) < math.cos(math.radians(20))
    back = (bends[:, :-1] * bends[:, 1:]).sum(-1) < 0
    return int((sharp[:, :-1] & sharp[:, 1:] & back).any(dim=1).sum())
