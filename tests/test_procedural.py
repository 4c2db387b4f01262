from dataclasses import replace

import pytest
import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.errors import InputError
from quaffure.geometry.surface import Surface
from quaffure.groom.clearance import CLEARANCE, distances_and_normals, inside_share, pushed_out, rest_surface
from quaffure.groom.groom import Groom
from quaffure.groom.hair_style import STYLES
from quaffure.groom.pose_transform import root_positions
from quaffure.groom.procedural import make_groom


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def surface(body: BodyModel) -> Surface:
    return rest_surface(body)


@pytest.fixture(scope="module")
def grooms(body: BodyModel, surface: Surface) -> dict[str, Groom]:
    return {name: make_groom(name, body, surface=surface) for name in STYLES}


@pytest.mark.parametrize("name", sorted(STYLES))
def test_strands_stand_on_the_scalp_and_outside_the_body(
    name: str, grooms: dict[str, Groom], body: BodyModel, surface: Surface
) -> None:
    groom = grooms[name]
    assert 2000 <= len(groom) <= 2600
    assert groom.rest_strands.shape[1:] == (24, 3)
    assert groom.texels().unique().numel() == len(groom)
    assert torch.isin(groom.root_faces, body.scalp.faces).all()
    roots = root_positions(groom, body.rest_vertices[None], body)[0]
    assert torch.allclose(groom.rest_strands[:, 0], roots, atol=1e-6)
    assert torch.allclose(body.scalp.uv_at(groom.root_faces, groom.root_barycentric), groom.root_uv)
    assert inside_share(groom.rest_strands, surface) <= 5e-4
    # The outer half of a strand has reached the full clearance.
    distance, _ = distances_and_normals(groom.rest_strands[:, 12:], surface)
    assert torch.quantile(distance, 0.01) > 0.8 * CLEARANCE


@pytest.mark.parametrize("name", sorted(STYLES))
def test_no_hair_in_the_face(name: str, grooms: dict[str, Groom], body: BodyModel) -> None:
    head = body.rest_joints[body.joint_names.index("Head")]
    x, y, z = (grooms[name].rest_strands - head).unbind(-1)
    in_face = (x.abs() < 0.035) & (y < -0.08) & (z.abs() < 0.07)
    assert in_face.float().mean() < 2e-3


@pytest.mark.parametrize("name", sorted(STYLES))
def test_the_scalp_is_covered_evenly(name: str, grooms: dict[str, Groom]) -> None:
    roots = grooms[name].rest_strands[:, 0]
    spacing = torch.cdist(roots, roots).topk(2, largest=False).values[:, 1]
    assert spacing.max() < 2.5 * spacing.median()
    assert abs(float(roots[:, 0].mean())) < 2e-3  # as many on the left as on the right


def test_lengths_are_those_of_the_styles(grooms: dict[str, Groom]) -> None:
    assert 0.33 < grooms["long_straight"].strand_lengths.median() < 0.40
    assert 0.33 < grooms["long_wavy"].strand_lengths.median() < 0.45
    assert 0.13 < grooms["bob"].strand_lengths.median() < 0.26
    assert 0.05 < grooms["short_curly"].strand_lengths.median() < 0.14
    for groom in grooms.values():
        even = groom.rest_lengths.amin(1) / groom.rest_lengths.mean(1)
        assert torch.quantile(even, 0.01) > 0.5


def test_long_hair_hangs_and_parts(grooms: dict[str, Groom]) -> None:
    strands = grooms["long_straight"].rest_strands
    assert (strands[:, -1, 2] < strands[:, 0, 2]).all()
    front = strands[strands[:, 0, 1] < -0.11]
    left = front[:, 0, 0] > 0.005
    right = front[:, 0, 0] < -0.005
    assert (front[left, -1, 0] > 0.03).all()
    assert (front[right, -1, 0] < -0.03).all()


def test_curls_wind(grooms: dict[str, Groom]) -> None:
    """The way from root to tip is much shorter than a curly strand, and nearly as long as a straight one."""

    def stretch(groom: Groom) -> float:
        ends = (groom.rest_strands[:, -1] - groom.rest_strands[:, 0]).norm(dim=1)
        return float((ends / groom.strand_lengths).median())

    assert stretch(grooms["short_curly"]) < 0.65
    assert stretch(grooms["bob"]) > 0.75


def test_the_same_seed_gives_the_same_groom(body: BodyModel, surface: Surface, grooms: dict[str, Groom]) -> None:
    assert torch.equal(make_groom("bob", body, seed=0, surface=surface).rest_strands, grooms["bob"].rest_strands)
    small = replace(STYLES["bob"], root_rows=12)
    first, other = (make_groom(small, body, seed=seed, surface=surface).root_uv for seed in (0, 1))
    assert first.shape != other.shape or not torch.equal(first, other)


def test_controls_do_what_they_say(body: BodyModel, surface: Surface) -> None:
    plain = replace(STYLES["bob"], root_rows=20, cut_height=None)
    short, long = (make_groom(replace(plain, length=length), body, surface=surface) for length in (0.1, 0.2))
    assert torch.isclose(long.strand_lengths.median() / short.strand_lengths.median(), torch.tensor(2.0), rtol=0.1)
    assert short.name == "procedural"
    flat, up = (make_groom(replace(plain, fall=fall), body, surface=surface) for fall in (1.0, 0.0))
    assert up.rest_strands[:, -1, 2].mean() > flat.rest_strands[:, -1, 2].mean() + 0.05


def test_unknown_styles_are_refused(body: BodyModel) -> None:
    with pytest.raises(InputError, match="bob"):
        make_groom("beehive", body)


def test_pushed_out_keeps_roots_and_lengths(grooms: dict[str, Groom], body: BodyModel, surface: Surface) -> None:
    strands = grooms["long_straight"].rest_strands[::10].clone()
    head = body.rest_joints[body.joint_names.index("Head")]
    pressed = strands.clone()
    pressed[:, 1:] += 0.12 * (head - strands[:, 1:]).clamp(-0.2, 0.2)
    before = inside_share(pressed, surface)
    result = pushed_out(pressed, surface)
    assert before > 0.05
    assert inside_share(result, surface) <= 5e-4
    assert torch.equal(result[:, 0], pressed[:, 0])
    lengths, kept = (s.diff(dim=1).norm(dim=-1).sum(1) for s in (pressed, result))
    assert torch.quantile((kept / lengths - 1).abs(), 0.98) < 0.01
