"""Resampling of ragged polylines to a common number of vertices."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from quaffure.config import VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.hair.strand_attributes import concatenate_attributes
from quaffure.hair.strands import GOAL_WEIGHT, HELD_PARTS, STIFFNESS_SCALE, TIE_VERTEX, UNASKED, Strands, held_parts_of

# A strand shorter than this share of the median strand is a point, not a hair.
SHORTEST = 0.02


def concatenate_strands(parts: list[Strands]) -> Strands:
    """One groom of several files in the same units and axes.

    Raises:
        InputError: no parts.
    """
    if not parts:
        raise InputError("groom", "at least one strand file", "none")
    return Strands(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.counts for part in parts]),
        ", ".join(part.source for part in parts),
        **{name: _concatenated(parts, name) for name in HELD_PARTS},
        dropped=sum(part.dropped for part in parts),
        attributes=concatenate_attributes(
            [part.attributes for part in parts],
            [part.counts for part in parts],
            [Path(part.source).stem for part in parts],
        ),
    )


def polyline_lengths(strands: Strands) -> Float[np.ndarray, " s"]:
    """Length of every strand [file units]."""
    return np.add.reduceat(_steps(strands), strands.starts)


def has_length(strands: Strands) -> Bool[np.ndarray, " s"]:
    """Whether each strand is long enough to be a hair, relative to the others."""
    lengths = polyline_lengths(strands)
    return lengths > max(SHORTEST * float(np.median(lengths)), float(np.finfo(np.float32).tiny))


def without_degenerate(strands: Strands) -> tuple[Strands, int]:
    """The strands of sufficient length, and the number of the others.

    Raises:
        InputError: none has.
    """
    kept = has_length(strands)
    if not kept.any():
        raise InputError(strands.source, "strands with a length", f"{len(strands)} strands of zero length")
    return strands.select(kept), int((~kept).sum())


def resample_by_arc_length(strands: Strands, vertices: int = VERTICES_PER_STRAND) -> Float[np.ndarray, "s n 3"]:
    """Evenly spaced points along each polyline; the first and the last are its own ends.

    Raises:
        InputError: a strand has no length.
    """
    _check_lengths(strands)
    right, weight = arc_length_places(strands, vertices)
    return values_at_places(strands.points.astype(np.float64), right, weight).astype(np.float32)


def arc_length_places(strands: Strands, vertices: int) -> tuple[Int[np.ndarray, "s n"], Float[np.ndarray, "s n"]]:
    """Evenly spaced places along each polyline: the point that follows each place, and its share of the mean with the
    point before it. The first and the last place are the ends of the polyline. On a strand without a length, points
    count as one length apart.
    """
    local, strand = _positions(strands)
    wanted = np.linspace(0.0, 1.0, vertices)
    ends = strands.starts + strands.counts - 1
    targets = np.arange(len(strands))[:, None] * 2.0 + wanted
    right = np.searchsorted(strand * 2.0 + local, targets.ravel(), side="left").reshape(targets.shape)
    right = np.clip(right, strands.starts[:, None] + 1, ends[:, None])
    span = local[right] - local[right - 1]
    weight = np.where(span > 0, (wanted - local[right - 1]) / np.where(span > 0, span, 1.0), 1.0)
    right[:, 0], weight[:, 0] = strands.starts + 1, 0.0
    right[:, -1], weight[:, -1] = ends, 1.0
    return right, weight


def values_at_places(
    values: Float[np.ndarray, "p ..."], right: Int[np.ndarray, "s n"], weight: Float[np.ndarray, "s n"]
) -> Float[np.ndarray, "s n ..."]:
    """Values of points, at the places of `arc_length_places`."""
    share = weight.reshape(*weight.shape, *[1] * (values.ndim - 1))
    return (1 - share) * values[right - 1] + share * values[right]


def resample_held_parts(strands: Strands, vertices: int = VERTICES_PER_STRAND) -> dict[str, np.ndarray]:
    """Those of `HELD_PARTS` that the strands have, on strands resampled by `resample_by_arc_length`, as in `Groom`.

    Goals are weights [J] and shared out among the new edges by length; a new edge of which less than half was held is
    free. Stiffness is a mean. A tie goes to the nearest vertex.

    Raises:
        InputError: a strand has no length.
    """
    _check_lengths(strands)
    local, strand = _positions(strands)
    axis, wanted = strand * 2.0 + local, np.arange(len(strands))[:, None] * 2.0 + np.linspace(0.0, 1.0, vertices)
    span = np.diff(local, append=0.0)
    span[strands.starts + strands.counts - 1] = 0.0

    def integral(of_edges: Float[np.ndarray, " p"]) -> Float[np.ndarray, "s e"]:
        """Over each new edge, of values that each belong to the edge that begins at a point."""
        before = np.cumsum(of_edges) - of_edges
        return np.diff(np.interp(wanted.ravel(), axis, before).reshape(wanted.shape), axis=1)

    parts: dict[str, np.ndarray] = {}
    if strands.stiffness_scale is not None:
        mean = (vertices - 1) * integral(strands.stiffness_scale * span)
        parts[STIFFNESS_SCALE] = mean.clip(min=1.0).astype(np.float32)
    if strands.goal_weight is not None:
        goal = np.where(span > 0, strands.goal_weight, 0.0)
        held = (vertices - 1) * integral((goal > 0) * span) >= 0.5
        parts[GOAL_WEIGHT] = np.where(held, integral(goal), 0.0).astype(np.float32)
    if strands.tie_vertex is not None:
        place = local[strands.starts + strands.tie_vertex.clip(min=0)]
        nearest = np.rint(place * (vertices - 1)).astype(np.int64)
        parts[TIE_VERTEX] = np.where(strands.tie_vertex >= 0, nearest, -1)
    return parts


def held_parts_by_strand(strands: Strands) -> dict[str, np.ndarray]:
    """Those of `HELD_PARTS` that the strands have, as in `Groom`; all strands have as many points."""
    return {
        name: values if name == TIE_VERTEX else values.reshape(len(strands), -1)[:, :-1]
        for name, values in held_parts_of(strands).items()
    }


def _check_lengths(strands: Strands) -> None:
    without = int((polyline_lengths(strands) <= 0).sum())
    if without:
        raise InputError(strands.source, "strands with a length", f"{without} of zero length")


def _positions(strands: Strands) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Position of every point on its strand, from 0 at the root to 1 at the tip, and the index of that strand.

    Strand s covers [2 s, 2 s + 1] on an axis on which the points of all strands increase.
    """
    steps = _steps(strands)
    points = np.repeat(np.add.reduceat(steps, strands.starts) <= 0, strands.counts)
    steps[points] = 1.0
    steps[strands.starts] = 0.0
    total = np.add.reduceat(steps, strands.starts)
    along = np.cumsum(steps / np.repeat(total, strands.counts))
    strand = np.repeat(np.arange(len(strands)), strands.counts)
    local = along - along[strands.starts][strand]
    return local / local[strands.starts + strands.counts - 1][strand], strand


def _concatenated(parts: list[Strands], name: str) -> np.ndarray | None:
    """One of `HELD_PARTS` of several files; None where no file has it."""
    if all(getattr(part, name) is None for part in parts):
        return None
    sizes = [len(part.counts if name == TIE_VERTEX else part.points) for part in parts]
    own = (getattr(part, name) for part in parts)
    return np.concatenate(
        [np.full(size, UNASKED[name]) if values is None else values for values, size in zip(own, sizes)]
    )


def _steps(strands: Strands) -> Float[np.ndarray, " p"]:
    """Distance of every point from the one before it on its strand; zero at roots."""
    steps = np.zeros(len(strands.points))
    steps[1:] = np.linalg.norm(np.diff(strands.points.astype(np.float64), axis=0), axis=1)
    steps[strands.starts] = 0.0
    return steps
