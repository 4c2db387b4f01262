"""Strands of a file: ragged, in the file's own units and axes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from quaffure.errors import InputError


@dataclass(frozen=True)
class Strands:
    """Polylines of any length, before registration to a body.

    Attributes:
        points: all vertices of all strands one after another [file units].
        counts: vertices of each strand, roots first; each at least 2.
        source: the file, for messages.
    """

    points: Float[np.ndarray, "p 3"]
    counts: Int[np.ndarray, " s"]
    source: str

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def starts(self) -> Int[np.ndarray, " s"]:
        """Index in `points` of each strand's root."""
        return np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(np.int64)

    @property
    def roots(self) -> Float[np.ndarray, "s 3"]:
        return self.points[self.starts]


def checked_strands(points: np.ndarray, counts: np.ndarray, source: str | Path) -> Strands:
    """Strands from what a reader found; strands of fewer than two vertices (bald roots) are dropped.

    Raises:
        InputError: no strand is left, the counts do not add up, or a coordinate is not finite.
    """
    points = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 3)
    counts = np.asarray(counts, dtype=np.int64)
    if counts.sum() != len(points):
        raise InputError(source, f"{counts.sum()} points for its {len(counts)} strands", f"{len(points)}")
    kept = np.repeat(counts >= 2, counts)
    points, counts = points[kept], counts[counts >= 2]
    if len(counts) == 0:
        raise InputError(source, "at least one strand of two or more points", "no strands")
    bad = int(np.count_nonzero(~np.isfinite(points).all(axis=1)))
    if bad:
        raise InputError(source, "finite coordinates", f"NaN or infinity in {bad} of {len(points)} points")
    return Strands(points, counts, str(source))
