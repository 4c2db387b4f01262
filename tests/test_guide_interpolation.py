"""Strands between guides: they follow them, part where they part, and keep their lengths, curls and distance."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from jaxtyping import Float, Int

from quaffure import InputError
from quaffure.body import BodyModel, load_body
from quaffure.geometry import matrix_from_axis_angle
from quaffure.geometry.signed_distance import signed_distance
from quaffure.hair import (
    DrapeSequence,
    Groom,
    GuideInterpolation,
    groom_of_drape,
    interpolation_of,
    select_guides,
)
from quaffure.hair.guide_interpolation import axis_projection, spacing_slack
from quaffure.hair.guide_triangles import (
    COHERENT,
    DIVERGED,
    coherence,
    first_direction_vertex,
    sample_roots,
    triangulate,
)
from quaffure.procedural import STYLES, make_groom
from quaffure.scene import BodyBatch, Scene
from tests.scenes import Registered

ROWS, LENGTH, VERTICES = 24, 0.2, 24
SHARE = torch.linspace(0, 1, VERTICES)


def coherence_reference(
    axes: Float[np.ndarray, "s n 3"], lengths: Float[np.ndarray, " s"], pairs: Int[np.ndarray, "*p 2"]
) -> Float[np.ndarray, "*p"]:
    """Twin of `coherence` for pairs of guides, in the precision of its input.

    Args:
        axes: guides without their curls, relative to their roots [m].
        lengths: of the guides at rest [m].
    """
    first = first_direction_vertex(axes.shape[1])
    share = np.linspace(0, 1, axes.shape[1])[first:]
    gap = np.linalg.norm(np.diff(axes[pairs][..., first:, :], axis=-3)[..., 0, :, :], axis=-1)
    length_along = lengths[pairs].mean(axis=-1)[..., None] * share
    apart = ((gap / length_along).max(axis=-1) - COHERENT) / (DIVERGED - COHERENT)
    apart = np.clip(apart, 0, 1)
    return 1 - apart * apart * (3 - 2 * apart)


def strands_reference(
    interpolation: GuideInterpolation, guides: Float[np.ndarray, "s n 3"], body_vertices: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "m n 3"]:
    """Slow twin of `GuideInterpolation.strands`, in the precision of its input."""
    relative = guides - guides[:, :1]
    axes = axis_projection(guides.shape[1]).astype(guides.dtype) @ relative
    detail = (relative - axes)[interpolation.guides[:, 0]]
    shares = interpolation.weights.astype(guides.dtype)
    first, others = interpolation.guides[:, :1], interpolation.guides[:, 1:]
    pairs = np.stack([np.repeat(first, 2, axis=1), others], axis=-1)
    shares[:, 1:] *= coherence_reference(axes, interpolation.guide_lengths, pairs)
    shares /= shares.sum(1, keepdims=True)
    mixed = (shares[..., None, None] * axes[interpolation.guides]).sum(1)
    roots = (interpolation.root_weights[..., None] * body_vertices[interpolation.carriers]).sum(1)
    return roots[:, None] + mixed + detail


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


def groom_of(body: BodyModel, offsets: torch.Tensor, uv: torch.Tensor) -> Groom:
    """Strands `offsets` from their roots at `uv` of the scalp chart."""
    faces, weights = body.scalp.locate(uv)
    roots = (weights[..., None] * body.rest_vertices[body.faces[faces]]).sum(-2)
    return Groom("sample", roots[:, None] + offsets, faces, weights, uv)


def even_uv(body: BodyModel) -> torch.Tensor:
    centre = (torch.arange(ROWS) + 0.5) / ROWS
    v, u = torch.meshgrid(centre, centre, indexing="ij")
    uv = torch.stack([u, v], -1).reshape(-1, 2)
    return uv[body.scalp.locate(uv)[0] >= 0]


def straight(direction: torch.Tensor) -> torch.Tensor:
    return LENGTH * SHARE[:, None] * direction[:, None]


@pytest.fixture(scope="module")
def parted(body: BodyModel) -> Groom:
    """Straight hair, to the right on the right half of the scalp and to the left on the left half."""
    uv = even_uv(body)
    side = torch.where(uv[:, 0] < 0.5, -1.0, 1.0)
    direction = torch.stack([0.8 * side, torch.zeros_like(side), torch.full_like(side, 0.6)], -1)
    return groom_of(body, straight(direction), uv)


@pytest.fixture(scope="module")
def curly(body: BodyModel) -> Groom:
    """Helices out of step with one another, and lengths that differ a little."""
    uv = even_uv(body)
    generator = torch.Generator().manual_seed(0)
    phase = 6.283 * torch.rand(len(uv), 1, generator=generator) + 6.283 * 3 * SHARE
    radius = 0.008 * (SHARE * 6).clamp(max=1)
    wave = torch.stack([radius * phase.cos(), radius * phase.sin(), -LENGTH * SHARE.expand_as(phase)], -1)
    wave = (wave - wave[:, :1]) * (0.95 + 0.1 * torch.rand(len(uv), 1, 1, generator=generator))
    return groom_of(body, wave, uv)


def numpy_rest(groom: Groom, body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    return groom.rest_strands.numpy(), body.rest_vertices.numpy()


def lengths(strands: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(strands, axis=1), axis=-1).sum(1)


def test_no_strand_averages_across_a_parting(body: BodyModel, parted: Groom) -> None:
    interpolation = interpolation_of(parted, body, 4000)
    right = parted.root_uv[:, 0].numpy()[interpolation.guides] < 0.5
    crossing = right.any(axis=1) & ~right.all(axis=1)
    assert crossing.sum() > 100
    assert (interpolation.weights[right != right[:, :1]] == 0).all()
    tips = interpolation.strands(*numpy_rest(parted, body))
    sideways = np.abs(tips[:, -1, 0] - tips[:, 0, 0])
    np.testing.assert_allclose(sideways, 0.8 * LENGTH, atol=1e-5)
    np.testing.assert_allclose(lengths(tips), LENGTH, atol=1e-5)


def test_a_split_that_opens_in_the_drape_is_followed_smoothly(body: BodyModel) -> None:
    """Guides that hang together at rest swing apart: no strand is left half way, and none jumps."""
    uv = even_uv(body)
    groom = groom_of(body, straight(torch.tensor([[0.0, 0.0, -1.0]]).expand(len(uv), -1)), uv)
    interpolation = interpolation_of(groom, body, 3000)
    vertices = body.rest_vertices.numpy()
    side = np.where(uv[:, 0] < 0.5, -1.0, 1.0)
    frames = []
    for angle in np.radians(np.linspace(0, 60, 241)):
        direction = np.stack([side * np.sin(angle), 0 * side, np.full_like(side, -np.cos(angle))], -1)
        guides = numpy_rest(groom, body)[0][:, :1] + straight(torch.from_numpy(direction)).numpy()
        frames.append(interpolation.strands(guides.astype(np.float32), vertices))
    tips = np.stack(frames)[:, :, -1]
    swing = LENGTH * np.radians(60) / 240
    assert np.linalg.norm(np.diff(tips, axis=0), axis=-1).max() < 8 * swing
    apart = np.abs(tips[-1, :, 0] - frames[-1][:, 0, 0])
    np.testing.assert_allclose(apart, LENGTH * np.sin(np.radians(60)), atol=1e-5)


def test_curls_keep_their_radius_and_strands_their_length(body: BodyModel, curly: Groom) -> None:
    interpolation = interpolation_of(curly, body, 3000)
    rest, vertices = numpy_rest(curly, body)
    strands = interpolation.strands(rest, vertices)
    of_guides = lengths(rest)[interpolation.guides]
    error = np.maximum(lengths(strands) / of_guides.max(1) - 1, 1 - lengths(strands) / of_guides.min(1))
    assert np.quantile(error, 0.99) < 0.02
    averaged = (interpolation.weights[..., None, None] * (rest - rest[:, :1])[interpolation.guides]).sum(1)
    radius, flattened = curl_radius(strands), curl_radius(averaged)
    assert abs(radius / curl_radius(rest) - 1) < 0.05
    assert flattened < 0.8 * radius  # what plain means would do


def curl_radius(strands: np.ndarray) -> float:
    """Mean distance of the outer half of the strands from their axes [m]."""
    finer = strands - strands[:, :1] - axis_projection(strands.shape[1]) @ (strands - strands[:, :1])
    return float(np.linalg.norm(finer[:, VERTICES // 2 :], axis=-1).mean())


@pytest.mark.parametrize("bend", [0.0, 0.4])
def test_kernel_and_reference_agree(body: BodyModel, curly: Groom, bend: float) -> None:
    interpolation = interpolation_of(curly, body, 700, seed=3)
    rest, vertices = numpy_rest(curly, body)
    twist = bend * np.random.default_rng(0).standard_normal((len(rest), 1, 3)) * SHARE.numpy()[:, None] * LENGTH
    guides = (rest + twist).astype(np.float32)
    out = np.full((700, VERTICES, 3), np.nan, np.float32)
    found = interpolation.strands(guides, vertices, out)
    assert found is out
    expected = strands_reference(interpolation, guides.astype(np.float64), vertices.astype(np.float64))
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_roots_ride_on_the_body_and_strands_with_them(body: BodyModel, parted: Groom) -> None:
    interpolation = interpolation_of(parted, body, 500)
    rest, vertices = numpy_rest(parted, body)
    turn = matrix_from_axis_angle(torch.tensor([0.3, -0.5, 0.9])).numpy()
    shift = np.array([0.1, 0.2, -0.3], np.float32)
    moved = interpolation.strands(rest @ turn.T + shift, vertices @ turn.T + shift)
    np.testing.assert_allclose(moved, interpolation.strands(rest, vertices) @ turn.T + shift, atol=2e-6)
    roots = (interpolation.root_weights[..., None] * vertices[interpolation.carriers]).sum(1)
    np.testing.assert_allclose(interpolation.strands(rest, vertices)[:, 0], roots, atol=1e-6)
    assert np.isin(np.sort(interpolation.carriers, 1), np.sort(body.faces[body.scalp.faces].numpy(), 1)).all()


def test_roots_are_spread_evenly_and_the_same_for_the_same_seed(body: BodyModel, parted: Groom) -> None:
    interpolation = interpolation_of(parted, body, 5000)
    again, other = (interpolation_of(parted, body, 5000, seed) for seed in (0, 1))
    np.testing.assert_array_equal(interpolation.root_weights, again.root_weights)
    assert (interpolation.root_weights != other.root_weights).any()
    assert len(interpolation) == 5000
    np.testing.assert_allclose(interpolation.weights.sum(1), 1, atol=1e-6)
    assert (interpolation.weights >= 0).all()
    per_guide = np.bincount(interpolation.guides[:, 0], minlength=len(parted))
    assert (per_guide > 0.25 * per_guide.mean()).mean() > 0.95
    assert per_guide.max() < 2.5 * per_guide.mean()


def test_places_fill_every_triangle_by_its_share() -> None:
    roots = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    triangle, shares = sample_roots(np.array([[0, 1, 2], [0, 2, 3]]), roots, 1000, 0)
    assert np.bincount(triangle).tolist() == [500, 500]
    assert (shares >= 0).all()
    np.testing.assert_allclose(shares.sum(1), 1)
    first = shares[triangle == 0]
    np.testing.assert_allclose(first.mean(0), 1 / 3, atol=0.01)
    points = first @ roots[[0, 1, 2], :2]
    nearest = np.sort(np.linalg.norm(points[:, None] - points, axis=-1), axis=1)[:, 1]
    assert nearest.min() > 0.2 * np.sqrt(0.5 / 500)  # random points come far closer


def test_gaps_stay_bald() -> None:
    centre = (np.arange(10) + 0.5) / 40
    u, v = (grid.ravel() for grid in np.meshgrid(centre, centre))
    uv = np.concatenate([np.stack([u, v], 1), np.stack([u + 0.7, v], 1)])
    roots = np.concatenate([uv, np.zeros((len(uv), 1))], axis=1)
    triangles = triangulate(uv, roots, "two tufts")
    assert len(triangles) == 2 * 2 * 81
    assert ((triangles < 100).all(1) | (triangles >= 100).all(1)).all()


def test_few_guides_are_blended(body: BodyModel) -> None:
    """Of a hundred guides, unlike their neighbours, a strand takes less than of 2,465 from the nearest alone."""
    groom = make_groom(STYLES["bob_fringe"], body)
    few = groom.thinned(100)
    kept = [interpolation_of(guides, body, 2000).weights[:, 0].mean() for guides in (few, groom)]
    assert kept[0] < 0.72  # 0.84 without slack
    assert kept[1] == pytest.approx(0.61, abs=0.03)  # of a mean of barycentric weights, the largest
    roots = groom.rest_strands[:, 0].numpy()
    assert spacing_slack(triangulate(groom.root_uv.numpy(), roots, "bob"), roots) == 1


def test_coherence_falls_with_the_angle() -> None:
    angles = np.radians([0, 10, 15, 20, 25, 40])
    axes = LENGTH * SHARE.numpy()[:, None] * np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], -1)[:, None]
    pairs = np.stack([np.zeros(6, np.int64), np.arange(6)], -1)
    together = coherence_reference(axes, np.full(6, LENGTH), pairs)
    found = [coherence(axes[0], axis, 2 * LENGTH, first_direction_vertex(VERTICES)) for axis in axes]
    np.testing.assert_allclose(found, together, atol=1e-5)
    assert together[:2].tolist() == [1, 1]
    assert together[-1] == 0
    assert (np.diff(together[1:]) < 0).all()


def drape_of(groom: Groom, body: BodyModel, poses: torch.Tensor) -> DrapeSequence:
    scene = Scene(groom, BodyBatch(body, poses, torch.zeros(len(poses), 10)))
    return DrapeSequence(
        strands=scene.posed.numpy(),
        posed=scene.posed.numpy(),
        rest_lengths=groom.rest_lengths.numpy(),
        body_vertices=scene.bodies.posed.vertices.numpy(),
        body_faces=body.faces.numpy().astype(np.int32),
        body_pose=poses.numpy(),
        body_shape=np.zeros(10, np.float32),
        fps=30.0,
        meta={"groom": "sample"},
    )


def test_the_groom_of_a_drape_is_found_again(body: BodyModel, curly: Groom) -> None:
    poses = 0.2 * torch.randn(2, 81, generator=torch.Generator().manual_seed(0))
    sequence = drape_of(curly, body, poses)
    found = groom_of_drape(sequence, body)
    np.testing.assert_allclose(found.root_uv, curly.root_uv, atol=1e-4)
    same = found.root_faces == curly.root_faces  # a root on an edge may go to either face
    assert same.float().mean() > 0.97
    np.testing.assert_allclose(found.rest_strands[same], curly.rest_strands[same], atol=1e-5)


def test_bad_input_is_named(body: BodyModel, parted: Groom) -> None:
    for count in (0, -3, 10**9):
        with pytest.raises(InputError, match=f"strands: expected 1 to 1000000, found {count}"):
            interpolation_of(parted, body, count)
    for few in (torch.arange(2), torch.arange(4)):  # the first four roots lie in one row
        with pytest.raises(InputError, match="sample: expected three guides or more, not on a line"):
            interpolation_of(parted.select(few), body, 10)
    interpolation = interpolation_of(parted, body, 10)
    with pytest.raises(InputError, match=r"guides: expected .* found \(9, 24, 3\)"):
        interpolation.strands(parted.rest_strands.numpy()[:9], body.rest_vertices.numpy())
    sequence = drape_of(parted, body, torch.zeros(1, 81))
    with pytest.raises(InputError, match="a drape on the shipped body, found another"):
        groom_of_drape(replace(sequence, body_faces=sequence.body_faces[:-2]), body)
    with pytest.raises(InputError, match="of the scalp, found"):
        groom_of_drape(replace(sequence, posed=sequence.posed + np.float32(0.1)), body)


@pytest.mark.slow
@pytest.mark.shared_data
def test_strands_of_a_real_groom_stay_out_of_the_body(body: BodyModel, registered: Registered) -> None:
    groom = select_guides(registered("grooms/sintel/sintel_hair_16points.tfx")[0])
    interpolation = interpolation_of(groom, body, 3000)
    rest, vertices = numpy_rest(groom, body)
    strands = interpolation.strands(rest, vertices)
    surface = BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)).surface
    distance = signed_distance(torch.from_numpy(strands[:, 1:].reshape(1, -1, 3)), surface)
    assert (distance < 0).float().mean() < 1e-3
    assert (distance < -2e-3).float().mean() < 1e-4
    ratio = lengths(strands) / (interpolation.weights * lengths(rest)[interpolation.guides]).sum(1)
    assert np.abs(ratio - 1).mean() < 0.02
