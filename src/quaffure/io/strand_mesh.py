"""Strands as meshes, for programs without curves: flat ribbons, or tubes of three sides."""

from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Int

Profile = Literal["ribbons", "tubes"]
SIDES = {"ribbons": 2, "tubes": 3}
"""Vertices of the mesh around a vertex of a strand."""
LEAST = 1e-9


def strand_mesh_positions(
    points: Float[np.ndarray, "p 3"], counts: Int[np.ndarray, " m"], width: Float[np.ndarray, " p"], profile: Profile
) -> Float32[np.ndarray, "v 3"]:
    """Vertices of the mesh, strand by strand, each vertex's together.

    Ribbons lie flat on the head: across the strand and across the direction from the middle of all roots.

    Args:
        points: vertices of all strands one after another, roots first [m].
        counts: of each strand.
        width: at each of the vertices [m].
    """
    across, normal = _across_and_outward(points, counts)
    radius = 0.5 * width[:, None]
    directions = [across, -across] if profile == "ribbons" else _around(across, normal)
    return np.stack([points + radius * side for side in directions], axis=1).reshape(-1, 3).astype(np.float32)


def strand_mesh_normals(
    points: Float[np.ndarray, "p 3"], counts: Int[np.ndarray, " m"], profile: Profile
) -> Float32[np.ndarray, "v 3"]:
    """Unit normals of the same vertices: away from the head, or of tubes away from the strand."""
    across, normal = _across_and_outward(points, counts)
    directions = [normal, normal] if profile == "ribbons" else _around(across, normal)
    return np.stack(directions, axis=1).reshape(-1, 3).astype(np.float32)


def strand_mesh_faces(counts: Int[np.ndarray, " m"], profile: Profile) -> Int[np.ndarray, "k 3"]:
    """Triangles between the vertices around each vertex of a strand and the next one's."""
    around = SIDES[profile]
    ring = np.delete(np.arange(counts.sum()), np.cumsum(counts) - 1)[:, None] * around
    first = np.arange(1 if profile == "ribbons" else around)
    a, b = ring + first, ring + (first + 1) % around
    corners = np.stack([np.stack([a, b + around, b], -1), np.stack([a, a + around, b + around], -1)], -2)
    return corners.reshape(-1, 3)


def _across_and_outward(
    points: Float[np.ndarray, "p 3"], counts: Int[np.ndarray, " m"]
) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors across each strand, along the head and away from it."""
    ends = np.cumsum(counts)
    index, first, last = np.arange(len(points)), np.repeat(ends - counts, counts), np.repeat(ends - 1, counts)
    tangent = points[np.minimum(index + 1, last)] - points[np.maximum(index - 1, first)]
    across = _unit(np.cross(tangent, points - points[ends - counts].mean(axis=0)))
    return across, _unit(np.cross(across, tangent))


def _around(across: np.ndarray, normal: np.ndarray) -> list[np.ndarray]:
    """Directions from a strand to the sides of its tube."""
    angles = 2 * np.pi * np.arange(SIDES["tubes"]) / SIDES["tubes"]
    return [np.cos(angle) * across + np.sin(angle) * normal for angle in angles]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), LEAST)
