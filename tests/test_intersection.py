"""Winding numbers."""

import igl
import numpy as np
import pytest
import torch

from quaffure.body import BodyModel, bundled_clip
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.winding_number import winding_numbers
from quaffure.scene import BodyBatch
from tests.scenes import sphere_mesh


@pytest.fixture(scope="module")
def bent(body: BodyModel) -> BodyBatch:
    return BodyBatch(body, bundled_clip("bow", body).body_pose[50:51], torch.full((1, 10), 0.5))


def test_winding_numbers_agree_with_an_independent_library(bent: BodyBatch) -> None:
    vertices, faces = bent.posed.vertices[0].numpy(), bent.body.faces.numpy()
    generator = np.random.default_rng(0)
    places = vertices[generator.integers(len(vertices), size=3000)]
    points = (places + generator.normal(0, 0.02, places.shape)).astype(np.float32)
    winding = winding_numbers(points, vertices, faces)
    expected = igl.winding_number(vertices.astype(np.float64), faces, points.astype(np.float64))
    np.testing.assert_array_equal(winding, np.round(expected))
    assert 0.2 < (winding > 0).mean() < 0.8
    nearest = signed_distance(torch.from_numpy(points)[None], bent.surface)[0].numpy() < 0
    assert (nearest != (winding > 0)).mean() < 0.01


def test_points_in_line_with_edges_and_corners_are_counted_once() -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    # Two triangles a side, counter-clockwise from outside; the diagonals of top and bottom run through the middle.
    faces = np.array(
        [[0, 2, 4], [6, 4, 2], [1, 5, 3], [7, 3, 5], [0, 4, 1], [5, 1, 4],
         [2, 3, 6], [7, 6, 3], [0, 1, 2], [3, 2, 1], [4, 6, 5], [7, 5, 6]]
    )  # fmt: skip
    along = np.linspace(0.05, 0.95, 7)
    diagonals = np.concatenate(
        [np.stack([along, 1 - along, 0 * along + 0.5], 1), np.stack([along, along, 0 * along + 0.5], 1)]
    )
    np.testing.assert_array_equal(winding_numbers(diagonals, corners, faces), 1)
    np.testing.assert_array_equal(winding_numbers(diagonals, corners, faces[:, ::-1]), -1)
    np.testing.assert_array_equal(winding_numbers(diagonals + np.array([0, 0, 0.6]), corners, faces), 0)
    np.testing.assert_array_equal(winding_numbers(diagonals - np.array([0, 0, 0.6]), corners, faces), 0)
    np.testing.assert_array_equal(winding_numbers(diagonals + np.array([3, 0, 0]), corners, faces), 0)


def test_overlapping_surfaces_count_twice() -> None:
    vertices, faces = (array.numpy() for array in sphere_mesh(0.1))
    both = np.concatenate([vertices, vertices + np.float32([0.1, 0, 0])])
    points = np.float32([[-0.05, 0, 0], [0.05, 0, 0], [0.15, 0, 0], [0.25, 0, 0]])
    np.testing.assert_array_equal(
        winding_numbers(points, both, np.concatenate([faces, faces + len(vertices)])), [1, 2, 1, 0]
    )
