"""Which draped strands drive a strand of a groom's source: near ones of a similar shape, and the one that it is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from quaffure.hair.groom import Groom
from quaffure.hair.resample import arc_length_places, polyline_lengths, values_at_places
from quaffure.hair.strands import Strands

DRIVING = 3
CANDIDATES = 8
"""Guides with the nearest roots, among which those of the most similar shape drive a strand."""
PLACES = 8
"""Places along a strand at which shapes are compared."""
SAME_ROOT = 2e-5
"""Distance of a root from that of a draped strand that is the same one [m]."""
SAME_LENGTH = 0.2
"""Relative difference of lengths up to which it may be: what leaves the skin changes its length."""
SOFTENING = 1e-3  # m: distance below which a nearer guide gains nothing


class DrivingGuides(NamedTuple):
    """Guides of every strand.

    Attributes:
        guides: indices, the largest share first.
        shares: sum to 1.
        own: the guide that a strand is itself, -1 for none. No guide is two strands.
    """

    guides: Int[np.ndarray, "s 3"]
    shares: Float[np.ndarray, "s 3"]
    own: Int[np.ndarray, " s"]


def driving_guides(strands: Strands, groom: Groom, on_scalp: Bool[np.ndarray, " s"]) -> DrivingGuides:
    """Three of the guides with near roots: a guide's share is the inverse square of the distance between the roots and
    the mean distance between the shapes together, without the root.

    A third of a style's strands driving the others, these are 10 % nearer to their own drapes than with the nearest
    roots alone: locks part from one another within millimetres at the roots.

    Args:
        strands: on the body at rest, roots first [m].
        on_scalp: no guide is a strand elsewhere.
    """
    rest = groom.rest_strands.numpy()
    count = min(CANDIDATES, len(rest))
    distance, guides = cKDTree(rest[:, 0]).query(strands.roots, k=[*range(1, count + 1)])
    shape = _relative(strands, PLACES)
    deviation = np.stack([_deviation(shape, strands, groom, guides[:, k]) for k in range(count)], axis=1)
    apart = distance + deviation
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :DRIVING]
    chosen, shares = np.take_along_axis(guides, nearest, 1), np.take_along_axis(apart, nearest, 1)
    shares = 1 / (shares + SOFTENING) ** 2
    # Across a parting at rest; the first one stays in any case.
    shares[:, 1:] *= _agreement(shape[:, -1], (rest[:, -1] - rest[:, 0])[chosen[:, 1:]]) ** 2
    missing = ((0, 0), (0, DRIVING - chosen.shape[1]))
    chosen, shares = np.pad(chosen, missing, mode="edge"), np.pad(shares, missing)
    own = _own(strands, groom, guides[:, 0], np.where(on_scalp, distance[:, 0], np.inf), deviation[:, 0])
    return DrivingGuides(chosen, shares / shares.sum(1, keepdims=True), own)


def _relative(strands: Strands, places: int) -> Float[np.ndarray, "s p 3"]:
    """Evenly spaced places along each strand after its root, relative to the root [m]."""
    found = values_at_places(strands.points, *arc_length_places(strands, places + 1))
    return found[:, 1:] - found[:, :1]


def _deviation(
    shape: Float[np.ndarray, "s p 3"], strands: Strands, groom: Groom, guides: Int[np.ndarray, " s"]
) -> Float[np.ndarray, " s"]:
    """Mean distance of each strand from a guide at the same arc lengths, both relative to their roots [m]."""
    rest, last = groom.rest_strands.numpy(), groom.rest_strands.shape[1] - 1
    lengths, share = polyline_lengths(strands), np.linspace(0, 1, shape.shape[1] + 1)[1:]
    of_guides = np.maximum(groom.strand_lengths.numpy()[guides], np.finfo(np.float32).tiny)
    at = np.minimum(share * (lengths / of_guides)[:, None], 1.0) * last
    before = np.minimum(at.astype(np.int64), last - 1)
    weight = (at - before)[..., None]
    row = guides[:, None]
    places = (1 - weight) * rest[row, before] + weight * rest[row, before + 1] - rest[guides, :1]
    return np.asarray(np.linalg.norm(places - shape, axis=-1).mean(axis=1))


def _agreement(along: Float[np.ndarray, "s 3"], of_guides: Float[np.ndarray, "s k 3"]) -> Float[np.ndarray, "s k"]:
    """Cosine between the directions from root to tip, 0 for opposite ones."""
    norms = np.linalg.norm(along, axis=1)[:, None] * np.linalg.norm(of_guides, axis=2)
    return ((along[:, None] * of_guides).sum(2) / np.maximum(norms, np.finfo(float).tiny)).clip(min=0.0)


def _own(
    strands: Strands,
    groom: Groom,
    nearest: Int[np.ndarray, " s"],
    distance: Float[np.ndarray, " s"],
    deviation: Float[np.ndarray, " s"],
) -> Int[np.ndarray, " s"]:
    """The guide at a strand's root that is as long; of several strands there, the most similar is the guide itself."""
    longer = polyline_lengths(strands) / np.maximum(groom.strand_lengths.numpy()[nearest], np.finfo(np.float32).tiny)
    same = np.flatnonzero((distance < SAME_ROOT) & (np.abs(longer - 1) < SAME_LENGTH))
    same = same[np.lexsort((deviation[same], nearest[same]))]
    guides, first = np.unique(nearest[same], return_index=True)
    own = np.full(len(strands), -1)
    own[same[first]] = guides
    return own
