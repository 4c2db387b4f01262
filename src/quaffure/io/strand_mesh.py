"""Strands as meshes, for programs without curves: flat ribbons, or tubes of three sides."""

from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Int

Profile = Literal["ribbons", "tubes"]
SIDES = {"ribbons": 2, "tubes": 3}
"""Vertices of the mesh around a vertex of a strand."""
LEAST = 1e-9


def strand_mesh_positions(
    strands: Float[np.ndarray, "m p 3"], width: Float[np.ndarray, " p"], profile: Profile
) -> Float32[np.ndarray, "v 3"]:
    """Vertices of the mesh, strand by strand, each vertex's together.

    Ribbons lie flat on the head: across the strand and across the direction from the middle of all roots.

    Args:
        strands: [m].
        width: of a strand at each of its vertices [m].
    """
    across, normal = _across_and_outward(strands)
    radius = 0.5 * width[None, :, None]
    directions = [across, -across] if profile == "ribbons" else _around(across, normal)
    return np.stack([strands + radius * side for side in directions], axis=2).reshape(-1, 3).astype(np.float32)


def strand_mesh_normals(strands: Float[np.ndarray, "m p 3"], profile: Profile) -> Float32[np.ndarray, "v 3"]:
    """Unit normals of the same vertices: away from the head, or of tubes away from the strand."""
    across, normal = _across_and_outward(strands)
    directions = [normal, normal] if profile == "ribbons" else _around(across, normal)
    return np.stack(directions, axis=2).reshape(-1, 3).astype(np.float32)


def strand_mesh_faces(strands: int, points: int, profile: Profile) -> Int[np.ndarray, "k 3"]:
    """Triangles between the vertices around each vertex of a strand and the next one's."""
    around = SIDES[profile]
    ring = np.arange(strands * points).reshape(strands, points)[:, :-1, None] * around
    first = np.arange(1 if profile == "ribbons" else around)
    a, b = ring + first, ring + (first + 1) % around
    corners = np.stack([np.stack([a, b + around, b], -1), np.stack([a, a + around, b + around], -1)], -2)
    return corners.reshape(-1, 3)


def _across_and_outward(strands: Float[np.ndarray, "m p 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors across each strand, along the head and away from it."""
    tangent, outward = np.gradient(strands, axis=1), strands - strands[:, 0].mean(axis=0)
    across = _unit(np.cross(tangent, outward))
    return across, _unit(np.cross(across, tangent))


def _around(across: np.ndarray, normal: np.ndarray) -> list[np.ndarray]:
    """Directions from a strand to the sides of its tube."""
    angles = 2 * np.pi * np.arange(SIDES["tubes"]) / SIDES["tubes"]
    return [np.cos(angle) * across + np.sin(angle) * normal for angle in angles]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), LEAST)
