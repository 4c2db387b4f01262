"""The grid of faces against its torch twin, and against the exact signed distance."""

import numpy as np
import pytest
import torch
from numba import njit

from quaffure.body import BodyModel
from quaffure.body.collision_skin import ABOVE, BELOW, THIN, collision_skin
from quaffure.geometry import TriangleGrid
from quaffure.geometry import triangle_grid as module
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.triangle_grid import (
    IN_BLOCK,
    NONE,
    OUT_OF_BAND,
    nearest_triangle_in_band,
    triangle_grid,
)
from quaffure.geometry.triangle_grid_reference import nearest_triangle_in_band_reference
from quaffure.geometry.triangle_leaves import nearest_in_band, triangle_leaves
from quaffure.scene import BodyBatch


@pytest.fixture(scope="module")
def bodies(body: BodyModel) -> BodyBatch:
    generator = torch.Generator().manual_seed(3)
    pose = 0.2 * torch.randn(1, 81, generator=generator)
    return BodyBatch(body, pose, torch.randn(1, 10, generator=generator))


def head_of(bodies: BodyBatch) -> torch.Tensor:
    return bodies.posed.joint_positions[0, bodies.body.joint_names.index("Head")]


@pytest.fixture(scope="module")
def skin_vertices(bodies: BodyBatch) -> torch.Tensor:
    return bodies.posed.vertices[0, collision_skin(bodies.body).vertices].contiguous()


@pytest.fixture(scope="module")
def points(bodies: BodyBatch, skin_vertices: torch.Tensor) -> torch.Tensor:
    """Within 2 cm of places on the skin, on both sides, in the grid."""
    generator = torch.Generator().manual_seed(5)
    faces = collision_skin(bodies.body).faces
    chosen = faces[torch.randint(len(faces), (3000,), generator=generator)]
    weights = torch.rand(3000, 3, 1, generator=generator)
    places = (weights / weights.sum(1, keepdim=True) * skin_vertices[chosen]).sum(1)
    points = places + 0.04 * (torch.rand(3000, 3, generator=generator) - 0.5)
    offset = points - head_of(bodies)
    return points[((offset > -0.45) & (offset < 0.2)).all(dim=1)]


@njit
def _ask(points: np.ndarray, grid: TriangleGrid) -> tuple[np.ndarray, np.ndarray]:
    heights, faces, rows = np.empty(len(points)), np.empty(len(points), np.int64), np.empty(2 * IN_BLOCK, np.float32)
    for index in range(len(points)):
        heights[index], faces[index] = nearest_triangle_in_band(
            points[index, 0], points[index, 1], points[index, 2], grid, rows
        )
    return heights, faces


def grid_over(bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor) -> TriangleGrid:
    skin, head = collision_skin(bodies.body), head_of(bodies)
    twice = points.repeat_interleave(2, dim=0)  # every second one is used
    return triangle_grid(skin_vertices.numpy(), skin.faces.numpy(), skin.band, head.numpy(), twice.numpy())


def test_kernel_and_twin_agree(bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor) -> None:
    skin = collision_skin(bodies.body)
    heights, faces = _ask(points.numpy(), grid_over(bodies, skin_vertices, points))
    expected, nearest = nearest_triangle_in_band_reference(
        points, skin_vertices, skin.faces, torch.from_numpy(skin.band)
    )
    found = nearest >= 0
    assert 0.2 < found.float().mean() < 0.8
    alike = torch.from_numpy(faces) == nearest
    assert alike.float().mean() > 0.99  # where two are as near as each other, rounding decides on one
    np.testing.assert_allclose(heights[alike], expected[alike], atol=2e-6)
    np.testing.assert_allclose(heights, expected, atol=1e-4)


@pytest.mark.slow
def test_leaves_leave_out_no_face(bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor) -> None:
    skin = collision_skin(bodies.body)
    band, corners = torch.from_numpy(skin.band), skin_vertices[skin.faces]
    leaves = triangle_leaves(corners, torch.arange(len(corners)))
    height, face = nearest_in_band(points, corners, leaves, band)
    expected, nearest = nearest_triangle_in_band_reference(points, skin_vertices, skin.faces, band)
    assert 0.2 < (face >= 0).float().mean() < 0.8
    assert torch.equal(face, nearest)
    torch.testing.assert_close(height, expected, atol=1e-6, rtol=0)


@pytest.mark.slow
def test_points_close_to_the_skin_learn_their_distance(
    bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor
) -> None:
    skin = collision_skin(bodies.body)
    exact = signed_distance(points[None], bodies.surface)[0]
    heights, nearest = nearest_triangle_in_band_reference(
        points, skin_vertices, skin.faces, torch.from_numpy(skin.band)
    )
    close = exact.abs() < 0.002
    assert close.sum() > 150
    assert (nearest[close] >= 0).float().mean() > 0.98  # the others are further beside a face than they may be
    near = close & (nearest >= 0)
    # Beyond the edge of a face its plane is nearer than the face.
    off = heights[near].abs() - exact[near].abs()
    assert off.max() < 1e-5
    assert (off > -1e-3).all()
    assert (heights[near].sign() == exact[near].sign()).float().mean() > 0.99


def test_lists_find_room(
    bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = _ask(points.numpy(), grid_over(bodies, skin_vertices, points))
    rooms = []
    one_try = module._list
    monkeypatch.setattr(module, "_BLOCKS_PER_FACE", 0.0)
    monkeypatch.setattr(module, "_list", lambda *all_of: rooms.append(len(all_of[-1])) or one_try(*all_of))
    found = _ask(points.numpy(), grid_over(bodies, skin_vertices, points))
    assert len(rooms) > 1
    for one, other in zip(found, expected):
        np.testing.assert_array_equal(one, other)


def test_far_from_the_head_nothing_is_near(bodies: BodyBatch, skin_vertices: torch.Tensor) -> None:
    away = skin_vertices[:200] + torch.tensor([5.0, 0.0, 0.0])
    heights, faces = _ask(away.numpy(), grid_over(bodies, skin_vertices, away))
    assert (faces == NONE).all()
    assert (heights == 1).all()


def test_the_skin_ends_at_the_waist(body: BodyModel) -> None:
    skin = collision_skin(body)
    places = body.rest_vertices[skin.vertices]
    assert 3000 < len(skin.vertices) < len(body.rest_vertices)
    assert places[:, 2].min() > body.rest_joints[body.joint_names.index("LeftLeg"), 2]
    kept = {tuple(face) for face in skin.vertices[skin.faces].tolist()}
    assert all(tuple(face) in kept for face in body.faces[body.scalp.faces].tolist())
    kinds = {(round(float(low), 4), round(float(high), 4)) for low, high in skin.band}
    assert kinds == {(BELOW, ABOVE), *((depth, depth) for depth in THIN)}


def test_thin_skin_is_that_of_fingers(body: BodyModel) -> None:
    skin = collision_skin(body)
    led_by = [body.joint_names[int(joint)] for joint in body.dense_skin_weights[skin.vertices].argmax(1)]
    thin = skin.band[:, 1] > ABOVE
    of_face = [led_by[corner] for corner in skin.faces[:, 0].tolist()]
    share = {
        part: np.mean([one for one, name in zip(thin, of_face) if part in name]) for part in ("Finger", "Arm", "Spine")
    }
    assert share["Finger"] > 0.8
    assert share["Arm"] < 0.2
    assert share["Spine"] < 0.01


def test_all_faces_are_those_near_the_points(
    bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor
) -> None:
    skin, head = collision_skin(bodies.body), head_of(bodies)
    everywhere = triangle_grid(skin_vertices.numpy(), skin.faces.numpy(), skin.band, head.numpy())
    few = points[::40]
    near = grid_over(bodies, skin_vertices, few)
    for one, other in zip(_ask(few.numpy(), near), _ask(few.numpy(), everywhere)):
        np.testing.assert_array_equal(one, other)
    away = head + torch.tensor([[0.3, 0.3, 0.1]])
    lonely = grid_over(bodies, skin_vertices, away)
    assert (_ask(points.numpy(), lonely)[1] == OUT_OF_BAND).mean() > 0.9


@pytest.mark.slow
def test_faces_without_area_are_left_out(bodies: BodyBatch, skin_vertices: torch.Tensor, points: torch.Tensor) -> None:
    skin, head = collision_skin(bodies.body), head_of(bodies)
    flat = torch.cat([skin.faces, skin.faces[::50][:, [0, 0, 1]]])
    reach = np.concatenate([skin.band, skin.band[::50]])
    expected = _ask(points.numpy(), grid_over(bodies, skin_vertices, points))
    found = _ask(points.numpy(), triangle_grid(skin_vertices.numpy(), flat.numpy(), reach, head.numpy()))
    twin = nearest_triangle_in_band_reference(points, skin_vertices, flat, torch.from_numpy(reach))
    assert (found[1] == expected[1]).mean() > 0.99
    assert (twin[1].numpy() == expected[1]).mean() > 0.99
