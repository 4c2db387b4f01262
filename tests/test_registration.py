from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from quaffure import InputError, load_groom
from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.hair import (
    FileFrame,
    Groom,
    HeadMesh,
    RegistrationReport,
    Strands,
    concatenate_strands,
    head_alignment,
    inside_share,
    register_groom,
    root_positions,
)
from quaffure.hair.file_frame import UNKNOWN
from quaffure.hair.head_alignment import FINE_ROUNDS, TRIAL_ROUNDS, Similarity, _Start, align
from quaffure.hair.registration import nearest_on_scalp
from quaffure.hair.registration_report import HeadFit
from quaffure.hair.scalp_target import ScalpTarget, scalp_target
from quaffure.hair.strands import checked_strands
from quaffure.io.read_strands import read_strands
from quaffure.procedural import STYLES, make_groom
from tests.scenes import Registered

SINTEL, SINTEL_HEAD = "grooms/sintel/sintel_hair_16points.tfx", "grooms/sintel/sintel_head.obj"
BASE = "cases/base_cm_yup.hair"
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from our axes to a file whose y is up and whose face is +z


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom(replace(STYLES["bob"], root_rows=28), body)


def as_file(rest: np.ndarray) -> Strands:
    return Strands(rest.reshape(-1, 3).astype(np.float32), np.full(len(rest), rest.shape[1]), "groom under test")


def checked(registered: Groom, body: BodyModel, surface: Surface) -> None:
    """What holds for whatever was registered."""
    roots = root_positions(registered, body.rest_vertices[None], body)[0]
    assert registered.rest_strands.shape[1:] == (24, 3)
    assert torch.allclose(registered.rest_strands[:, 0], roots, atol=1e-5)
    assert torch.allclose(body.scalp.uv_at(registered.root_faces, registered.root_barycentric), registered.root_uv)
    assert inside_share(registered.rest_strands, surface) <= 5e-4


CASES = {
    "metres, z up": (1.0, np.eye(3), [0.0, 0.0, 0.0]),
    "centimetres, y up, turned, shifted": (
        100.0,
        Rotation.from_euler("y", 10, degrees=True).as_matrix() @ Y_UP,
        [30.0, -5.0, 8.0],
    ),
    "millimetres, y up, facing -z": (1000.0, np.diag([-1.0, 1, -1]) @ Y_UP, [0.0, 900.0, 100.0]),
    "inches, z up, facing +x, head tilted": (
        1 / 0.0254,
        (Rotation.from_euler("z", 90, degrees=True) * Rotation.from_euler("x", 12, degrees=True)).as_matrix(),
        [3.0, -20.0, 0.0],
    ),
}  # fmt: skip
UNITS = dict(zip(CASES, ("m", "cm", "mm", "inch")))


@pytest.mark.parametrize("case", sorted(CASES))
def test_a_groom_comes_back_from_other_units_axes_and_place(
    case: str, groom: Groom, body: BodyModel, surface: Surface
) -> None:
    scale, rotation, shift = CASES[case]
    order = np.random.default_rng(0).permutation(len(groom))
    moved = scale * groom.rest_strands.numpy().astype(np.float64)[order] @ rotation.T + shift
    registered, report = register_groom(as_file(moved), body, "again", licence="CC0")
    assert (registered.name, registered.licence) == ("again", "CC0")
    assert len(registered) == report.kept == len(groom)
    assert report.unit == UNITS[case]
    assert report.scale * scale == pytest.approx(1.0, abs=0.03)
    assert np.degrees(Rotation.from_matrix(np.array(report.rotation) @ rotation).magnitude()) < 3.0
    error = (registered.rest_strands - groom.rest_strands[order]).norm(dim=-1)
    assert 1e3 * error[:, 0].median() < 3.0
    assert 1e3 * error.median() < 6.0
    assert report.median_residual < 1.5
    checked(registered, body, surface)


def test_a_bigger_head_is_scaled_to_ours(groom: Groom, body: BodyModel) -> None:
    _, report = register_groom(as_file(1.1 * groom.rest_strands.numpy()), body, "bigger")
    assert report.scale == pytest.approx(1 / 1.1, rel=0.03)
    assert report.unit == "m"


def test_strands_keep_their_shape_on_a_head_of_another_form(groom: Groom, body: BodyModel, surface: Surface) -> None:
    wider = groom.rest_strands + 0.09 * groom.rest_strands[:, :1] * torch.tensor([1.0, 0.0, 0.0])
    registered, report = register_groom(as_file(wider.numpy()), body, "wider")
    assert report.median_residual > 1
    assert torch.allclose(registered.strand_lengths, report.scale * groom.strand_lengths, rtol=0.01)
    # Roots move with their strands: the first edge is as even as all the others.
    assert torch.quantile((registered.rest_lengths[:, 0] / registered.rest_lengths[:, 1] - 1).abs(), 0.95) < 0.05
    checked(registered, body, surface)


@pytest.mark.slow
def test_the_order_of_the_strands_does_not_matter(groom: Groom, body: BodyModel) -> None:
    rest = groom.rest_strands.numpy()
    forth, _ = register_groom(as_file(rest), body, "forth")
    back, _ = register_groom(as_file(rest[::-1]), body, "back")
    assert torch.allclose(forth.rest_strands, back.rest_strands.flip(0), atol=1e-4)


def test_the_heads_own_mesh_gives_the_place_when_roots_are_few(groom: Groom, body: BodyModel) -> None:
    """Hair on the left half only: its roots alone are off by centimetres, the head tells where they belong."""
    half = groom.rest_strands[groom.rest_strands[:, 0, 0] > 0.01]
    shift = torch.tensor([1.0, 0.0, 0.5])
    head = HeadMesh((body.rest_vertices + shift).double().numpy(), body.faces.numpy())
    registered, report = register_groom(as_file((half + shift).numpy()), body, "half", head)
    assert 1e3 * (registered.rest_strands - half)[:, 0].norm(dim=-1).median() < 6.0
    assert report.scale == pytest.approx(1.0, abs=0.03)
    assert report.head is not None
    assert report.head.median < report.head.p95 < 10  # mm: the head is ours
    vertices = head.vertices * [1.15, 1.0, 1.0]
    wide = HeadMesh(vertices - vertices.mean(0) + head.vertices.mean(0), head.faces)
    _, report_of_wide = register_groom(as_file((half + shift).numpy()), body, "half", wide)
    assert report_of_wide.head is not None
    assert report_of_wide.head.median > 2 * report.head.median


def test_roots_beside_the_scalp_move_to_it_and_far_ones_are_dropped(
    groom: Groom, body: BodyModel, surface: Surface
) -> None:
    rest = groom.rest_strands.numpy().copy()
    rest[:50] += np.float32([0.0, 0.0, 0.4])
    registered, report = register_groom(as_file(rest), body, "some far")
    assert (report.kept, report.dropped) == (len(groom) - 50, 50)
    assert report.max_residual < 35
    assert report.unused == (0, 0, 50)
    said = (
        f"{report.kept} of {len(groom)} are hair of the scalp; left out: 50 with a root more than 35 mm from the scalp"
    )
    assert said in str(report)
    checked(registered, body, surface)


def test_nearest_on_scalp_agrees_with_every_triangle(body: BodyModel) -> None:
    generator = torch.Generator().manual_seed(0)
    on_scalp = body.rest_vertices[body.faces[body.scalp.faces[::40]]].mean(1)
    points = on_scalp + 0.02 * torch.randn(on_scalp.shape, generator=generator)
    _, weights, feet = nearest_on_scalp(points, body)
    corners = body.rest_vertices[body.faces[body.scalp.faces]]
    fine = torch.rand(400, 3, generator=generator)
    fine = fine / fine.sum(1, keepdim=True)
    samples = torch.einsum("wc,tcx->twx", fine, corners).reshape(-1, 3)
    # Not by matrix products, which round squares of metres.
    brute = torch.cdist(points, samples, compute_mode="donot_use_mm_for_euclid_dist").amin(1)
    found = (points - feet).norm(dim=1)
    assert (found <= brute + 1e-5).all()
    assert (found >= brute - 2e-3).all()
    assert torch.allclose(weights.sum(1), torch.ones(len(weights)))


def refused(roots: np.ndarray, body: BodyModel, expected: str) -> None:
    strands = roots[:, None] + np.linspace(0, 0.1, 8)[None, :, None] * np.array([0.0, 0.0, -1.0])
    with pytest.raises(InputError, match=expected):
        register_groom(as_file(strands), body, "wrong")


@pytest.mark.slow
def test_a_cloud_of_roots_is_refused(body: BodyModel) -> None:
    refused(np.random.default_rng(0).uniform(-0.12, 0.12, (1000, 3)), body, "scalp")


def test_what_is_no_head_of_hair_is_refused(body: BodyModel) -> None:
    generator = np.random.default_rng(0)
    refused(generator.normal(size=(3, 3)), body, "at least 20 strands, found 3")
    refused(np.ones((100, 3)), body, "one point")
    refused(generator.uniform(-0.1, 0.1, (500, 3)) * [1, 1, 0], body, "line or a plane")
    refused(generator.uniform(-0.1, 0.1, (500, 1)) * [1, 2, 3], body, "line or a plane")


@pytest.mark.parametrize(
    "name",
    ["long_straight", "ponytail", *(pytest.param(name, marks=pytest.mark.slow) for name in ("undercut", "afro"))],
)
def test_styles_register_onto_themselves(name: str, body: BodyModel) -> None:
    style = make_groom(replace(STYLES[name], root_rows=20), body)
    _, report = register_groom(as_file(100 * style.rest_strands.numpy() @ Y_UP.T), body, name)
    assert report.unit == "cm"
    assert report.up_axis == "+y"
    assert report.median_residual < 2


@pytest.mark.slow
@pytest.mark.shared_data
def test_sintel_fits_our_scalp(registered: Registered, body: BodyModel, surface: Surface) -> None:
    groom, report = registered(SINTEL)
    assert (report.unit, report.up_axis) == ("m", "+y")
    assert report.kept >= 11300
    assert report.median_residual < 4
    assert report.p95_residual < 10
    # Sintel faces +z and stands upright.
    assert np.degrees(Rotation.from_matrix(np.array(report.rotation) @ Y_UP).magnitude()) < 10
    checked(groom, body, surface)
    _, with_head = registered(SINTEL, head=SINTEL_HEAD)
    assert with_head.kept >= 11300
    assert with_head.median_residual < 6
    assert "head:" not in str(report)
    assert with_head.head is not None
    assert f"head: the skull of the head mesh is {with_head.head.median:.1f} mm from ours in the median" in str(
        with_head
    )


@pytest.mark.slow
@pytest.mark.shared_data
def test_ponytail_registers_from_its_four_parts(registered: Registered, body: BodyModel, surface: Surface) -> None:
    groom, report = registered(*(f"grooms/ponytail/{part}.tfx" for part in ("back", "front_top", "side", "tail")))
    assert report.kept >= 4900
    assert report.median_residual < 4
    # In no known unit; y up, and the face looks to -z.
    assert report.scale == pytest.approx(2.98e-3, rel=0.05)
    assert np.array(report.rotation)[1, 2] > 0.9
    checked(groom, body, surface)


@pytest.mark.slow
@pytest.mark.shared_data
def test_mohawk_from_another_species_registers_upright(
    registered: Registered, body: BodyModel, surface: Surface
) -> None:
    groom, report = registered("grooms/mohawk/Ratboy_mohawk.tfx")
    assert report.kept >= 1800
    assert report.median_residual < 9
    assert abs(float(groom.rest_strands[:, 0, 0].mean())) < 5e-3
    checked(groom, body, surface)


def rotation_from_y_up(report: RegistrationReport) -> float:
    """Angle [degrees] from the rotation that an upright file with y up, facing +z, must get."""
    return float(np.degrees(Rotation.from_matrix(report.rotation @ Y_UP).magnitude()))


@pytest.mark.parametrize("name", ["bob", "crew_cut"])
def test_a_full_head_of_hair_turned_in_its_file_is_turned_back(name: str, body: BodyModel) -> None:
    rest = make_groom(replace(STYLES[name], root_rows=20), body).rest_strands.numpy()
    turn = Rotation.from_euler("x", 20, degrees=True).as_matrix()
    _, report = register_groom(as_file(rest @ turn.T), body, name)
    assert np.degrees(Rotation.from_matrix(report.rotation @ turn).magnitude()) < 3.0


@pytest.mark.parametrize("name", ["bob", "crew_cut"])
def test_hair_on_the_crown_of_another_head_stays_upright(name: str, body: BodyModel) -> None:
    rest = make_groom(replace(STYLES[name], root_rows=28), body).rest_strands.numpy()
    crown = rest[rest[:, 0, 2] > 1.75] * np.float32([1.1, 0.92, 1.0])
    _, report = register_groom(as_file(crown @ Y_UP.T), body, name)
    assert rotation_from_y_up(report) < 5.0


@pytest.mark.parametrize("name", ["long_straight", pytest.param("crew_cut", marks=pytest.mark.slow)])
def test_strands_stored_from_tip_to_root_are_turned_round(name: str, body: BodyModel) -> None:
    groom = make_groom(replace(STYLES[name], root_rows=20), body)
    registered, report = register_groom(as_file(groom.rest_strands.flip(1).numpy()), body, name)
    assert report.turned
    assert "from tip to root" in str(report)
    assert 1e3 * (registered.rest_strands - groom.rest_strands).norm(dim=-1).median() < 3.0
    _, forwards = register_groom(as_file(groom.rest_strands.numpy()), body, name)
    assert not forwards.turned
    assert "from tip to root" not in str(forwards)


@pytest.mark.shared_data
@pytest.mark.slow
def test_a_cap_of_roots_from_another_head_is_not_pitched(shared_data: Path, body: BodyModel) -> None:
    strands = read_strands(shared_data / "cases" / "cap60_other_head.hair")
    _, report = register_groom(strands, body, "cap")
    assert rotation_from_y_up(report) < 5.0
    # Turned in its file: the hair hangs, and says so.
    turn = Rotation.from_euler("x", 20, degrees=True).as_matrix()
    turned = replace(strands, points=(strands.points @ turn.T).astype(np.float32))
    _, report = register_groom(turned, body, "cap")
    assert np.degrees(Rotation.from_matrix(report.rotation @ turn @ Y_UP).magnitude()) < 5.0


@pytest.mark.shared_data
def test_a_beard_is_recognised_and_left_out(registered: Registered) -> None:
    _, report = registered("cases/beard200.hair")
    assert rotation_from_y_up(report) < 5.0
    assert 1e3 * report.scale == pytest.approx(10.0, abs=0.05)
    assert (report.kept, report.dropped, report.beard) == (400, 0, 200)
    assert "strands: 400 of 600 are hair of the scalp; left out: 200 of a beard" in str(report).splitlines()


@pytest.mark.slow
@pytest.mark.shared_data
def test_a_reversed_file_registers_like_the_one_it_was_made_of(registered: Registered) -> None:
    base, report = registered(BASE)
    assert not report.turned
    back, report = registered("cases/reversed.hair")
    assert report.turned
    assert torch.allclose(back.rest_strands, base.rest_strands, atol=1e-4)


def test_a_tip_beyond_all_measure_raises_no_warning(groom: Groom, body: BodyModel) -> None:
    """Next to it the edges of the strand have no length; a damaged file had one."""
    few = groom.rest_strands[::60].numpy().astype(float)
    few[3, -1] = 1e30
    strands = Strands(few.reshape(-1, 3), np.full(len(few), few.shape[1]), "damaged")
    with pytest.raises(InputError):
        register_groom(strands, body, "damaged")


def test_a_strand_out_of_reach_is_refused(groom: Groom, body: BodyModel) -> None:
    """Beyond the second distance the lengths of edges have no squares in float32."""
    few = groom.rest_strands[:: len(groom.rest_strands) // 40][:40].numpy().astype(float)
    few[3, 12, 0] = 11.0
    strands = as_file(few)
    with pytest.raises(InputError, match="strands within 10 m of the body's origin, found 39 of 40 there"):
        register_groom(strands, body, "damaged", frame=FileFrame("z", "-y", "m"))
    few[3, 12, 0] = 1e20
    with pytest.raises(InputError, match=r"finite coordinates within 1e.09, found NaN, infinity or more in 1 of 960"):
        checked_strands(few.reshape(-1, 3), strands.counts, "damaged")


@pytest.mark.shared_data
def test_bald_roots_of_a_file_are_counted(shared_data: Path, body: BodyModel) -> None:
    strands = read_strands(shared_data / "cases" / "one_point_strands.hair")
    assert strands.dropped == 40
    _, report = register_groom(strands, body, "one point")
    assert (report.kept, report.dropped, report.unused) == (360, 40, (40, 0, 0))
    assert "strands: 360 of 400 are hair of the scalp; left out: 40 bald roots (fewer than two points)" in str(report)
    assert concatenate_strands([strands, strands]).dropped == 80


@pytest.mark.shared_data
def test_what_is_known_is_not_guessed(
    registered: Registered, shared_data: Path, body: BodyModel, surface: Surface
) -> None:
    strands = read_strands(shared_data / BASE)
    guessed, report = registered(BASE)
    assert (report.unit, report.up_axis, report.forward_axis) == ("cm", "+y", "+z")
    assert "guessed: unit (--units), up axis (--up), facing (--forward)" in str(report)
    known, report = register_groom(strands, body, "base", frame=FileFrame("y", "+z", "cm"))
    assert torch.allclose(known.rest_strands, guessed.rest_strands, atol=2e-3)
    assert "guessed" not in str(report)
    # A known axis is taken, however badly it fits.
    _, report = register_groom(strands, body, "base", frame=FileFrame("-y", "+z", "0.01"))
    assert report.up_axis == "-y"
    assert "units of 0.01 m" in str(report)
    assert report.dropped > 0


@pytest.mark.shared_data
def test_a_left_handed_file_is_mirrored(shared_data: Path, body: BodyModel) -> None:
    """Hair parted at the side shows which side it is."""
    strands = read_strands(shared_data / BASE)
    one_sided = strands.select(strands.roots[:, 0] > -2)
    expected, _ = register_groom(one_sided, body, "base", frame=FileFrame("y", "z", "cm"))
    mirrored = replace(one_sided, points=one_sided.points * np.float32([1, 1, -1]))
    frame = FileFrame("y", "-z", "cm", mirror=True)
    found, report = register_groom(mirrored, body, "mirrored", frame=frame)
    assert torch.allclose(found.rest_strands, expected.rest_strands, atol=1e-4)
    assert (report.up_axis, report.forward_axis) == ("+y", "-z")
    assert np.linalg.det(report.rotation) == pytest.approx(-1.0)
    assert "left-handed" in str(report)


def test_a_perfect_fit_costs_nothing_and_is_fitted_to_the_end(body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hair that hangs straight down from the very points of the scalp, whose small reward is no misfit below 0."""
    rounds: list[int] = []
    own_fit = head_alignment._fit

    def fit(points: np.ndarray, target: ScalpTarget, start: _Start, widths: list[float]) -> Similarity:
        rounds.append(len(widths))
        return own_fit(points, target, start, widths)

    monkeypatch.setattr(head_alignment, "_fit", fit)
    target = scalp_target(body)
    found = align(100 * target.points, np.array([0.0, 0.0, -1.0]), target, UNKNOWN)
    assert found.cost == 0
    assert rounds[-1] == FINE_ROUNDS - TRIAL_ROUNDS


def test_held_parts_of_a_registered_groom_stay_at_their_vertices(groom: Groom, body: BodyModel) -> None:
    """Also where vertices are not evenly spaced, as after an edit."""
    few = groom.rest_strands[::20].clone()
    few[:, 12] = 0.1 * few[:, 11] + 0.9 * few[:, 13]
    edges = torch.arange(23).expand(len(few), -1)
    held = {
        "stiffness_scale": 1.0 + edges,
        "goal_weight": 1e-5 * (edges < 5),
        "tie_vertex": torch.full((len(few),), 12),
    }
    file = as_file(few.numpy())
    points = {
        name: np.pad(held[name].numpy(), ((0, 0), (0, 1)), "edge").ravel()
        for name in ("stiffness_scale", "goal_weight")
    }
    file = replace(file, **points, tie_vertex=held["tie_vertex"].numpy())
    again, _ = register_groom(file, body, "again", frame=FileFrame(registered=True))
    for name, values in held.items():
        torch.testing.assert_close(getattr(again, name), values, check_dtype=False)


def test_a_registered_groom_is_not_moved(groom: Groom, body: BodyModel) -> None:
    few, known = groom.rest_strands[::20], FileFrame(registered=True)
    again, report = register_groom(as_file(few.numpy()), body, "again", frame=known)
    assert torch.equal(again.rest_strands, few)
    assert "on this body as it stands" in str(report)
    frame = FileFrame("y", "z", "cm", registered=True)
    again, _ = register_groom(as_file(100 * few.numpy() @ Y_UP.T), body, "again", frame=frame)
    assert torch.allclose(again.rest_strands, few, atol=1e-5)
    above = as_file(few.numpy() + np.float32([0, 0, 0.02]))
    with pytest.raises(InputError, match=r"most roots within 2 mm of this body's scalp, .*, found 5 of 31 there"):
        register_groom(above, body, "above", frame=known)
    few = few.clone()
    few[:9, :, 2] += 0.02  # eyebrows, say
    most, report = register_groom(as_file(few.numpy()), body, "most", frame=known)
    assert report.unused.too_far == len(few) - len(most) > 0
    assert "with a root more than 2 mm from the scalp" in str(report)
    assert torch.equal(most.rest_strands[-20:], few[-20:])


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ({"up": "w"}, r"--up: expected one of \+x, .*found 'w'"),
        ({"up": "y", "forward": "-y"}, "--forward: expected an axis across y"),
        ({"units": "furlong"}, "--units: expected one of m, cm, mm, inch, or metres in a unit, found 'furlong'"),
        ({"units": "-1"}, "--units"),
    ],
)
def test_axes_and_units_that_are_none(frame: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        FileFrame(**frame)


@pytest.mark.shared_data
def test_a_groom_inside_the_body_is_refused(shared_data: Path, body: BodyModel) -> None:
    """Strands that all grow into the head."""
    strands = read_strands(shared_data / BASE)
    points = strands.points.reshape(400, -1, 3)
    centre = points[:, :1].mean(axis=0, keepdims=True)
    share = np.linspace(0, 1, points.shape[1])[:, None]
    inward = points[:, :1] + share * 0.9 * (centre - points[:, :1])
    strands = as_file(inward.astype(np.float32))
    with pytest.raises(InputError, match=r"at most 40 % of the vertices inside the body .*found 100 %"):
        register_groom(strands, body, "inward", frame=FileFrame("y", "z", "cm"))


@pytest.mark.slow
@pytest.mark.shared_data
def test_single_reversed_strands_are_turned_round(
    registered: Registered, shared_data: Path, body: BodyModel, surface: Surface
) -> None:
    strands = read_strands(shared_data / BASE)
    expected, report = registered(BASE)
    assert report.turned_strands == 0
    points = strands.points.reshape(400, -1, 3).copy()
    points[::16] = points[::16, ::-1]
    found, report = register_groom(as_file(points), body, "some reversed")
    assert (report.kept, report.turned_strands, report.turned) == (400, 25, False)
    assert "25 single strands turned round" in str(report)
    assert 1e3 * (found.rest_strands - expected.rest_strands).norm(dim=-1).max() < 3.0


@pytest.mark.shared_data
def test_eyebrows_are_recognised_and_left_out(shared_data: Path, body: BodyModel, surface: Surface) -> None:
    strands = read_strands(shared_data / BASE)
    ear = body.rest_vertices[body.ear_vertices]
    x, y, z = body.rest_vertices.unbind(1)
    brow = (y < ear[:, 1].min() - 0.05) & ((z - ear[:, 2].max()).abs() < 0.012) & (x.abs() > 0.01) & (x.abs() < 0.05)
    roots = body.rest_vertices[brow][:40].numpy() @ Y_UP.T * 100
    hairs = roots[:, None] + np.linspace(0, 1, 24)[:, None] * np.float32([0.8, 0.2, 0.3])
    points = np.concatenate([strands.points.reshape(400, 24, 3), hairs.astype(np.float32)])
    _, report = register_groom(as_file(points), body, "brows")
    assert (report.kept, report.eyebrows, report.beard, report.dropped) == (400, len(hairs), 0, 0)
    assert f"left out: {len(hairs)} of eyebrows" in str(report)


@pytest.mark.shared_data
def test_a_groom_that_arrives_inside_the_body_is_warned_of(registered: Registered) -> None:
    _, report = registered(BASE)
    assert "warning" not in str(report)
    inside = replace(report, inside_before=0.31)
    assert "warning: 31 % of the points inside the body are many: give the head mesh" in str(inside)
    assert "(--head)" in str(inside)
    assert "warning: 31 %" in str(replace(inside, head=HeadFit(2.0, 4.0)))
    assert "--head" not in str(replace(inside, head=HeadFit(2.0, 4.0)))


def test_a_head_mesh_without_a_file_to_register_is_refused(body: BodyModel) -> None:
    with pytest.raises(InputError, match=r"head\.obj: expected no head mesh .*, found the bundled groom bob"):
        load_groom("bob", body, Path("head.obj"))
