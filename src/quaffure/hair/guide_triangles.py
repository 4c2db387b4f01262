"""Roots of strands between guides: triangles of neighbouring guides, and points distributed evenly over them.

The triangulation is Delaunay's, on the scalp's chart. A strand in a triangle of guides is a mean of the three with
barycentric weights, so that its tip has the same position among their tips as its root among their roots.
"""

import math

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from scipy.spatial import Delaunay, QhullError

from quaffure.errors import InputError

WIDEST_TRIANGLE = 4.0
"""Longest edge of a triangle, in median edge lengths: there is no hair across a wider gap."""
COHERENT, DIVERGED = 0.2, 0.45
"""Largest distance between two guides relative to the length from their roots: coherent up to the first value, diverged
from the second on [-]."""
# Share of the length from which on the direction of a strand is defined.
DIRECTION_START = 1 / 6
# Plastic number of the R2 sequence, two coordinates that cover a square evenly at any count (M. Roberts 2018,
# "The unreasonable effectiveness of quasirandom sequences").
PLASTIC = 1.3247179572447460


def triangulate(
    root_uv: Float[np.ndarray, "s 2"], roots: Float[np.ndarray, "s 3"], name: str
) -> Int[np.ndarray, "t 3"]:
    """Triangles of guides that are neighbours on the scalp; none across a gap in the hair.

    Args:
        root_uv: on the scalp's chart.
        roots: on the body at rest [m].
        name: of the groom, for messages.

    Raises:
        InputError: fewer than three guides, or all of them on a line.
    """
    try:
        triangles = Delaunay(root_uv.astype(np.float64)).simplices
    except (QhullError, ValueError) as error:
        raise InputError(
            name, "three guides or more, not on a line, for strands between them", f"{len(roots)}"
        ) from error
    edges = np.linalg.norm(roots[triangles] - roots[np.roll(triangles, 1, axis=1)], axis=-1)
    return triangles[edges.max(axis=1) <= WIDEST_TRIANGLE * np.median(edges)].astype(np.int64)


def sample_roots(
    triangles: Int[np.ndarray, "t 3"], roots: Float[np.ndarray, "s 3"], count: int, seed: int
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 3"]]:
    """Evenly distributed points with the density of the guides: the triangle of each, and its barycentric weights.

    The number in a triangle is its expectation rounded up or down (systematic sampling), without clumps inside.
    """
    generator = np.random.default_rng(seed)
    corners = roots[triangles].astype(np.float64)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area_of_guide = np.bincount(triangles.ravel(), np.repeat(area, 3), minlength=len(roots)) / 3
    expected = area / area_of_guide[triangles].mean(axis=1)
    total = np.cumsum(expected)
    stations = (np.arange(count) + generator.random()) / count * total[-1]
    triangle = np.minimum(np.searchsorted(total, stations, side="right"), len(triangles) - 1)
    rank = np.arange(count) - np.searchsorted(triangle, triangle)
    shift = generator.random((len(triangles), 2))[triangle]
    square = (shift + rank[:, None] / np.array([PLASTIC, PLASTIC**2])) % 1.0
    square = np.where(square.sum(axis=1, keepdims=True) > 1, 1 - square, square)
    return triangle, np.concatenate([1 - square.sum(axis=1, keepdims=True), square], axis=1)


@njit(cache=True, fastmath=True)
def coherence(a: np.ndarray, b: np.ndarray, both_lengths: float, first: int) -> float:
    """1 for two guides of similar shape, 0 for two that diverge, as at a parting, an ear or a shoulder.

    Args:
        a, b: the guides [n, 3] without their curls, relative to their roots [m].
        both_lengths: sum of their lengths at rest [m].
        first: see `first_direction_vertex`.
    """
    last = len(a) - 1
    largest = np.float32(0.0)
    for vertex in range(first, last + 1):
        x, y, z = a[vertex, 0] - b[vertex, 0], a[vertex, 1] - b[vertex, 1], a[vertex, 2] - b[vertex, 2]
        largest = max(largest, (x * x + y * y + z * z) / np.float32(vertex * vertex))
    ratio = np.sqrt(largest) * np.float32(2 * last) / both_lengths
    apart = min(max((ratio - np.float32(COHERENT)) / np.float32(DIVERGED - COHERENT), np.float32(0.0)), np.float32(1.0))
    return np.float32(1.0) - apart * apart * (np.float32(3.0) - np.float32(2.0) * apart)


def first_direction_vertex(vertices: int) -> int:
    """The first vertex at which the direction of a strand is defined."""
    return math.ceil(DIRECTION_START * (vertices - 1))
