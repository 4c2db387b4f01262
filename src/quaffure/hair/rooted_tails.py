"""Tails that are strands of their own: many roots in the tie, and other strands that end there.

So is the ponytail of TressFX modelled: 474 strands of the tail have their roots on a disc of 3 cm behind the head, and
the hair of the back of the head ends around it.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

PATCH = 0.01
"""Radius in which roots are counted [m]."""
DENSE = 6.0
"""Roots of a tail in a patch, relative to the median patch of the groom."""
FEWEST_ROOTS = 20
REACH = 0.03
"""Strands that end within this distance of where a tail begins end at its tie [m]."""
TAIL_START = 0.03
"""Length over which a tail begins [m]: its roots may have been moved to the scalp, away from the tie."""
LEAST_TOWARDS = 0.2
"""Cosine between the last edge of a strand that ends at a tie and the direction to the tie or that of its tail."""


def strands_that_end_at_tails(
    strands: Float[np.ndarray, "s n 3"], tied: Bool[np.ndarray, " s"]
) -> list[tuple[Float[np.ndarray, "3"], Int[np.ndarray, " m"]]]:
    """Centre of every tie in which a tail has its roots [m], and the strands that end there, without `tied` ones."""
    found, free = [], ~tied
    for tail in dense_roots(strands[:, 0]):
        arc = np.linalg.norm(np.diff(strands[tail], axis=1), axis=-1).cumsum(1)
        start = strands[tail, :-1][arc <= TAIL_START]
        centre = start.mean(0)
        axis = (strands[tail, 2] - strands[tail, 0]).mean(0)
        offset = centre - strands[:, -1]
        last = strands[:, -1] - strands[:, -2]
        distance, _ = cKDTree(start).query(strands[:, -1])
        towards = np.maximum(_cosine(last, offset), _cosine(last, np.broadcast_to(axis, last.shape)))
        ends = free & (distance < REACH) & (towards > LEAST_TOWARDS)
        ends[tail] = False
        free &= ~ends
        found.append((centre, np.flatnonzero(ends)))
    return found


def dense_roots(roots: Float[np.ndarray, "s 3"]) -> list[Int[np.ndarray, " m"]]:
    """Groups of roots that are far denser than those of the groom."""
    tree = cKDTree(roots)
    counts = tree.query_ball_point(roots, PATCH, return_length=True)
    dense = counts >= max(FEWEST_ROOTS, DENSE * np.median(counts))
    groups = []
    while dense.any():
        centre = int(np.where(dense, counts, 0).argmax())
        group = np.array(tree.query_ball_point(roots[centre], 2 * PATCH))
        groups.append(group[dense[group]])
        dense[group] = False
    return groups


def _cosine(a: Float[np.ndarray, "s 3"], b: Float[np.ndarray, "s 3"]) -> Float[np.ndarray, " s"]:
    return (a * b).sum(-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)).clip(min=1e-12)
