"""Close the holes of a triangle mesh without new vertices: each by the triangulation of least area."""

import numpy as np
from jaxtyping import Float, Int


def boundary_loops(faces: Int[np.ndarray, "k 3"]) -> list[Int[np.ndarray, " n"]]:
    """Vertices of each hole's rim, in the order that a filling face must follow to keep the orientation."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    count = edges.max(initial=0) + 1
    forwards, backwards = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    if np.array_equal(np.sort(forwards), np.sort(backwards)):  # most often, and much cheaper to see
        return []
    open_edges = ~np.isin(forwards, backwards)
    following = {end: start for start, end in edges[open_edges].tolist()}
    loops = []
    while following:
        loop = [min(following)]
        while loop[-1] in following:
            loop.append(following.pop(loop[-1]))
        loops.append(np.array(loop[:-1]))
    return loops


def fill_loop(loop: Int[np.ndarray, " n"], vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, "t 3"]:
    """Triangles [n - 2, 3] across a rim of n vertices, of least total area (dynamic programming, cubic in n)."""
    points, count = vertices[loop], len(loop)
    area = np.zeros((count, count))
    split = np.zeros((count, count), dtype=int)
    for span in range(2, count):
        for first in range(count - span):
            last = first + span
            middle = np.arange(first + 1, last)
            cross = np.cross(points[middle] - points[first], points[last] - points[first])
            costs = area[first, middle] + area[middle, last] + 0.5 * np.linalg.norm(cross, axis=-1)
            area[first, last], split[first, last] = costs.min(), middle[costs.argmin()]
    triangles, pending = [], [(0, count - 1)]
    while pending:
        first, last = pending.pop()
        if last - first >= 2:
            between = int(split[first, last])
            triangles.append((loop[first], loop[between], loop[last]))
            pending += [(first, between), (between, last)]
    return np.array(triangles)
