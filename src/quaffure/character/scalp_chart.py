"""A part of a surface as the scalp: a disc of triangles, unrolled to the unit square with little distortion."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from quaffure.errors import InputError

SQUARENESS = 4.0  # exponent of the superellipse that the rim is drawn towards; 2 is a circle
MARGIN = 0.01  # of the unit square, on each side
SLIM_ROUNDS = 60
SOFTNESS = 5.0  # weight that holds the rim to the rounded square; 0 lets it go
TRANSFERRED_WEIGHT = 1e4  # that holds vertices to their places in another chart
BAND = 0.2  # of the unit square, at each side, that moves where a chart is continued beyond it
MIDLINE = 1e-4, 0.01
"""Distances of the rim's vertices from the plane of symmetry, of a symmetric head and of any other [m]."""
LEAST_FACES, MOST_ROUNDS = 40, 20

Points = Float[np.ndarray, "p 3"]
Patch = Int[np.ndarray, "f 3"]


def face_neighbours(faces: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, "k 3"]:
    """The faces across the three edges of each face of a closed surface [K, 3]."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    owner = order // 3
    across = np.empty(len(edges), dtype=np.int64)
    across[order[0::2]], across[order[1::2]] = owner[1::2], owner[0::2]
    return across.reshape(-1, 3)


def disc(faces: Int[np.ndarray, "k 3"], wanted: Bool[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """The largest connected piece of some faces of a closed surface, its holes filled, without teeth and waists."""
    neighbours = face_neighbours(faces)
    piece = pieces(np.ones(len(faces), dtype=bool), neighbours)
    inside = wanted.copy()
    for _ in range(MOST_ROUNDS):
        before = inside.copy()
        # Two of three neighbours: corners are filled, and teeth go.
        inside |= inside[neighbours].sum(1) >= 2
        inside &= inside[neighbours].sum(1) >= 2
        inside = _largest_piece(inside, neighbours)
        if not inside.any():
            break
        # Another piece of the surface, such as a collar around a neck, is no hole.
        around = piece == piece[inside.argmax()]
        inside = around & ~_largest_piece(around & ~inside, neighbours)
        inside &= ~_at_waists(faces, inside)
        if (inside == before).all():
            break
    return np.asarray(inside)


def _largest_piece(chosen: Bool[np.ndarray, " k"], neighbours: Int[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
    """The chosen faces in the largest piece that is connected by edges."""
    piece = pieces(chosen, neighbours)
    sizes = np.bincount(piece[chosen], minlength=piece.max() + 1)
    return np.asarray(chosen & (piece == sizes.argmax()))


def pieces(chosen: Bool[np.ndarray, " k"], neighbours: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
    """Number of the piece of chosen faces, connected by edges, that each is in; all others are alone."""
    first = np.repeat(np.arange(len(chosen)), 3)
    second = neighbours.ravel()
    both = chosen[first] & chosen[second]
    links = coo_matrix((np.ones(both.sum()), (first[both], second[both])), shape=(len(chosen), len(chosen)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _at_waists(faces: Int[np.ndarray, "k 3"], inside: Bool[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Faces inside around vertices at which the rim touches itself."""
    patch = faces[inside]
    edges = np.concatenate([patch[:, [0, 1]], patch[:, [1, 2]], patch[:, [2, 0]]])
    count = faces.max() + 1
    rim = edges[~np.isin(edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0])]
    vertices, uses = np.unique(rim[:, 0], return_counts=True)
    return np.asarray(np.isin(faces, vertices[uses > 1]).any(1))


def check_disc(patch: Patch, source: str) -> None:
    """Refuse a scalp that is not one disc.

    Raises:
        InputError: it has holes, pieces, or hardly any faces.
    """
    import igl

    edges = np.sort(np.concatenate([patch[:, [0, 1]], patch[:, [1, 2]], patch[:, [2, 0]]]), axis=1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    euler = len(np.unique(patch)) - len(unique) + len(patch)
    rim = int((uses == 1).sum())
    if len(patch) < LEAST_FACES:
        raise InputError(source, f"a scalp of at least {LEAST_FACES} triangles of the head", f"{len(patch)}")
    loop = len(igl.boundary_loop(patch))
    if euler != 1 or rim != loop or uses.max() > 2:
        found = f"Euler characteristic {euler}, {rim} edges on its rim, the longest loop of {loop}"
        raise InputError(source, "a scalp that is one disc without holes", found)


def unrolled(points: Points, patch: Patch) -> Float[np.ndarray, "p 2"]:
    """Flat coordinates: harmonic into a rounded square, then relaxed by SLIM with a softly held rim [Rabinovich et al.
    2017, "Scalable locally injective mappings"]."""
    start, target, rim = _rounded(points, patch)
    return _slim(points, patch, start, rim, target, SOFTNESS)


def continued(
    points: Points, patch: Patch, uv: Float[np.ndarray, "p 2"], held: Int[np.ndarray, " h"]
) -> Float[np.ndarray, "p 2"]:
    """A chart that covers a part of a patch continued to all of it, and drawn into the unit square at its sides alone,
    where it leaves it; unrolled where it covers hardly any of it.

    Args:
        uv: places of the vertices in the chart, those in `held` counting.
        held: vertices that the chart covers.
    """
    known = np.isin(patch, held).all(1)
    if known.sum() < LEAST_FACES:
        return fitted_to_square(unrolled(points, patch))
    start, _, _ = _rounded(points, patch)
    metres = np.sqrt(_area(points, patch[known]) / _area(_in_space(uv), patch[known]))
    start += metres * uv[held].mean(0) - start[held].mean(0)
    wide = _slim(points, patch, start, held, metres * uv[held], TRANSFERRED_WEIGHT) / metres
    drawn = 1.0 - _drawn_in(1.0 - _drawn_in(wide))
    return fitted_to_square(wide) if flipped(drawn, patch) else drawn


def _drawn_in(uv: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p 2"]:
    """What is beyond 1 drawn to the margin, with a band before it and nothing else."""
    highest, first = uv.max(0), 1.0 - BAND
    drawn = first + (BAND - MARGIN) * (uv - first) / np.maximum(highest - first, BAND)
    return np.where((highest > 1.0) & (uv > first), drawn, uv)


def without_flips(points: Points, patch: Patch, uv: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p 2"]:
    """The chart, or the nearest one in which no triangle is turned over.

    Args:
        uv: places of the vertices in another head's chart.
    """
    if not flipped(uv, patch):
        return uv
    start, _, _ = _rounded(points, patch)
    metres = np.sqrt(_area(points, patch) / _area(_in_space(uv), patch))
    start += metres * uv.mean(0) - start.mean(0)
    everywhere = np.arange(len(points))
    return _slim(points, patch, start, everywhere, metres * uv, TRANSFERRED_WEIGHT) / metres


def _rounded(
    points: Points, patch: Patch
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "r 2"], Int[np.ndarray, " r"]]:
    """Harmonic coordinates in a rounded square of the patch's area [m], places of the rim, and its vertices."""
    import igl

    rim = igl.boundary_loop(patch).astype(np.int64)
    target = rounded_square(points[rim])
    start = igl.harmonic(points, patch, rim, target, 1)
    scale = np.sqrt(_area(points, patch) / _area(_in_space(start), patch))
    return start * scale, target * scale, rim


def _slim(
    points: Points,
    patch: Patch,
    start: Float[np.ndarray, "p 2"],
    held: Int[np.ndarray, " h"],
    target: Float[np.ndarray, "h 2"],
    weight: float,
) -> Float[np.ndarray, "p 2"]:
    import igl

    data = igl.slim_precompute(
        np.asfortranarray(points), np.asfortranarray(patch.astype(np.int32)), np.asfortranarray(start),
        igl.MappingEnergyType.SYMMETRIC_DIRICHLET, held.astype(np.int32), np.asfortranarray(target), weight,
    )  # fmt: skip
    return np.asarray(igl.slim_solve(data, SLIM_ROUNDS))[:, :2]


def edge_pairs(points: np.ndarray, patch: Patch) -> tuple[np.ndarray, np.ndarray]:
    """Two edges of each triangle, from its first corner."""
    corners = points[patch]
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def rounded_square(rim_points: Float[np.ndarray, "r 3"]) -> Float[np.ndarray, "r 2"]:
    """Places of the rim's vertices on a rounded square by arc length, the forehead's middle at the top."""
    steps = np.linalg.norm(np.roll(rim_points, -1, axis=0) - rim_points, axis=1)
    length = np.concatenate([[0], np.cumsum(steps)[:-1]]) / steps.sum()
    aside = np.abs(rim_points[:, 0])
    midline = next((near for near in (aside < limit for limit in MIDLINE) if near.any()), aside <= aside.min())
    front = np.flatnonzero(midline)[rim_points[midline, 1].argmin()]
    # Seen from outside the head the rim runs anticlockwise: from the forehead over the body's left side.
    angle = 2 * np.pi * (length - length[front])
    x, y = np.sin(angle), -np.cos(angle)
    radius = (np.abs(x) ** SQUARENESS + np.abs(y) ** SQUARENESS) ** (-1 / SQUARENESS)
    return np.stack([x, y], axis=1) * radius[:, None]


def fitted_to_square(uv: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p 2"]:
    """The chart stretched to the unit square but for its margin."""
    low, high = uv.min(0), uv.max(0)
    return MARGIN + (1 - 2 * MARGIN) * (uv - low) / (high - low)


def flipped(uv: Float[np.ndarray, "p 2"], patch: Patch) -> int:
    """Number of triangles that are turned over in the chart, or have no area there."""
    first, second = edge_pairs(uv, patch)
    return int((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] <= 0).sum())


def _in_space(uv: Float[np.ndarray, "p 2"]) -> Points:
    return np.pad(uv, ((0, 0), (0, 1)))


def _area(points: Points, patch: Patch) -> float:
    """Twice the area of the triangles."""
    return float(np.linalg.norm(np.cross(*edge_pairs(points, patch)), axis=-1).sum())
