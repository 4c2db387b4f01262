"""Strands of a file: ragged, in the file's own units and axes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from quaffure.errors import InputError
from quaffure.hair.strand_attributes import NONE, StrandAttributes

STIFFNESS_SCALE, GOAL_WEIGHT, TIE_VERTEX = HELD_PARTS = ("stiffness_scale", "goal_weight", "tie_vertex")
"""Optional arrays of strands, grooms and drapes: what an artist asks of parts of the strands."""
UNASKED = {STIFFNESS_SCALE: 1.0, GOAL_WEIGHT: 0.0, TIE_VERTEX: -1}
"""Their values where nothing is asked for."""
SCALE_SLACK = 1e-5
"""float32 rounds; a scale this much below 1 is taken as 1."""
LARGEST_FILE_COORDINATE = 1e9
"""Limit of coordinates in any unit: squares stay far from the overflow of float32."""


def held_parts_of(owner: object) -> dict[str, Any]:
    """Those of `HELD_PARTS` that strands, a groom or a drape have."""
    found = {name: getattr(owner, name) for name in HELD_PARTS}
    return {name: values for name, values in found.items() if values is not None}


@dataclass(frozen=True)
class Strands:
    """Polylines of any length, before registration to a body.

    Attributes:
        points: all vertices of all strands one after another [file units].
        counts: vertices of each strand, roots first; each at least 2.
        source: the file, for messages.
        stiffness_scale, goal_weight: as in `Groom`, of the edge that begins at each point; the tip repeats the last.
        tie_vertex: as in `Groom`, counted on each strand.
        dropped: strands of the file that are not here: bald roots, of fewer than two points.
        attributes: what else the file says of them.
        times: of the samples of an animated file, of which this is the first [s]; None of a file without.
    """

    points: Float[np.ndarray, "p 3"]
    counts: Int[np.ndarray, " s"]
    source: str
    stiffness_scale: Float[np.ndarray, " p"] | None = None
    goal_weight: Float[np.ndarray, " p"] | None = None
    tie_vertex: Int[np.ndarray, " s"] | None = None
    dropped: int = 0
    attributes: StrandAttributes = NONE
    times: Float[np.ndarray, " t"] | None = None

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def starts(self) -> Int[np.ndarray, " s"]:
        """Index in `points` of each strand's root."""
        return np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(np.int64)

    @property
    def roots(self) -> Float[np.ndarray, "s 3"]:
        return self.points[self.starts]

    def select(self, kept: Bool[np.ndarray, " s"]) -> "Strands":
        """Some of the strands."""
        points = np.repeat(kept, self.counts)
        changes: dict[str, Any] = {"points": self.points[points], "counts": self.counts[kept]}
        changes["attributes"] = self.attributes.select(kept, self.counts)
        for name, values in held_parts_of(self).items():
            changes[name] = values[kept if name == TIE_VERTEX else points]
        return replace(self, **changes)


def checked_times(times: np.ndarray, source: str | Path) -> Float[np.ndarray, " t"]:
    """Times of the samples of a file [s].

    Raises:
        InputError: one is not finite.
    """
    if not np.isfinite(times).all():
        raise InputError(source, "finite times of samples", "NaN or infinity")
    return times.astype(np.float64)


def checked_strands(
    points: np.ndarray,
    counts: np.ndarray,
    source: str | Path,
    held_parts: Mapping[str, Any] = MappingProxyType({}),
    attributes: StrandAttributes = NONE,
) -> Strands:
    """Strands from what a reader found; strands of fewer than two vertices (bald roots) are dropped, and counted.

    Args:
        held_parts: those of `HELD_PARTS` that the file has.
        attributes: what else it says of them.

    Raises:
        InputError: no strand is left, the counts do not add up, or a coordinate is not finite or beyond
            `LARGEST_FILE_COORDINATE`.
    """
    points = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 3)
    counts = np.asarray(counts, dtype=np.int64)
    if counts.sum() != len(points):
        raise InputError(source, f"{counts.sum()} points for its {len(counts)} strands", f"{len(points)}")
    bald = int((counts < 2).sum())
    every = Strands(points, counts, str(source), **held_parts, attributes=attributes.usable())
    strands = replace(every.select(counts >= 2), dropped=bald)
    if len(strands) == 0:
        raise InputError(source, "at least one strand of two or more points", "no strands")
    is_usable = np.abs(strands.points) <= LARGEST_FILE_COORDINATE  # not so of NaN
    bad = int(np.count_nonzero(~is_usable.all(axis=1)))
    if bad:
        expected = f"finite coordinates within {LARGEST_FILE_COORDINATE:g}"
        raise InputError(source, expected, f"NaN, infinity or more in {bad} of {len(strands.points)} points")
    return strands
