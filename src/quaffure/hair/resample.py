"""Resampling of ragged polylines to a common number of vertices."""

import numpy as np
from jaxtyping import Float

from quaffure.config import VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.hair.strands import Strands

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
    )


def polyline_lengths(strands: Strands) -> Float[np.ndarray, " s"]:
    """Length of every strand [file units]."""
    return np.add.reduceat(_steps(strands), strands.starts)


def without_degenerate(strands: Strands) -> tuple[Strands, int]:
    """The strands of sufficient length, and the number of the others.

    Raises:
        InputError: none has.
    """
    lengths = polyline_lengths(strands)
    kept = lengths > max(SHORTEST * float(np.median(lengths)), float(np.finfo(np.float32).tiny))
    if not kept.any():
        raise InputError(strands.source, "strands with a length", f"{len(strands)} strands of zero length")
    points = strands.points[np.repeat(kept, strands.counts)]
    return Strands(points, strands.counts[kept], strands.source), int((~kept).sum())


def resample_by_arc_length(strands: Strands, vertices: int = VERTICES_PER_STRAND) -> Float[np.ndarray, "s n 3"]:
    """Evenly spaced points along each polyline; the first and the last are its own ends.

    Raises:
        InputError: a strand has no length.
    """
    total = polyline_lengths(strands)
    if (total <= 0).any():
        raise InputError(strands.source, "strands with a length", f"{int((total <= 0).sum())} of zero length")
    # One increasing axis for all strands: strand s covers [s, s + 1] on it.
    along = np.cumsum(_steps(strands) / np.repeat(total, strands.counts))
    strand = np.repeat(np.arange(len(strands)), strands.counts)
    local = along - along[strands.starts][strand]
    wanted = np.linspace(0.0, 1.0, vertices)
    ends = strands.starts + strands.counts - 1
    local = local / local[ends][strand]
    targets = np.arange(len(strands))[:, None] * 2.0 + wanted
    right = np.searchsorted(strand * 2.0 + local, targets.ravel(), side="left").reshape(targets.shape)
    right = np.clip(right, strands.starts[:, None] + 1, ends[:, None])
    span = local[right] - local[right - 1]
    weight = np.where(span > 0, (wanted - local[right - 1]) / np.where(span > 0, span, 1.0), 1.0)[..., None]
    points = strands.points.astype(np.float64)
    result = (1 - weight) * points[right - 1] + weight * points[right]
    result[:, 0], result[:, -1] = points[strands.starts], points[ends]
    return result.astype(np.float32)


def _steps(strands: Strands) -> Float[np.ndarray, " p"]:
    """Distance of every point from the one before it on its strand; zero at roots."""
    steps = np.zeros(len(strands.points))
    steps[1:] = np.linalg.norm(np.diff(strands.points.astype(np.float64), axis=0), axis=1)
    steps[strands.starts] = 0.0
    return steps
