"""Curves as polylines: cubic bases with their wrap modes (USD, Alembic, RenderMan), and NURBS.

Cubic bases and wrap modes as UsdGeomBasisCurves defines them; a control point of a B-spline is not on its curve.
"""

import numpy as np
from jaxtyping import Float, Int

from quaffure.errors import InputError

LINEAR, BEZIER, BSPLINE, CATMULL_ROM = "linear", "bezier", "bspline", "catmullRom"
NONPERIODIC, PERIODIC, PINNED = "nonperiodic", "periodic", "pinned"
BASES = {
    BEZIER: np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 3, 0, 0], [1, 0, 0, 0]], dtype=float),
    BSPLINE: np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 0, 3, 0], [1, 4, 1, 0]]) / 6,
    CATMULL_ROM: np.array([[-1, 3, -3, 1], [2, -5, 4, -1], [-1, 0, 1, 0], [0, 2, 0, 0]]) / 2,
}
"""Rows: coefficients of t^3, t^2, t, 1; columns: the four control points of a segment."""
POINTS_PER_CURVE = 64
DENSE = 8
"""Points of a strand of which the chords are within a percent of a smooth curve's length."""
FEWEST_PER_SEGMENT, MOST_PER_SEGMENT = 2, 8

Points = Float[np.ndarray, "p 3"]
Counts = Int[np.ndarray, " s"]
Polylines = tuple[Float[np.ndarray, "q 3"], Counts]
"""Points of all polylines one after another, and the number of each."""


def is_basis_valid(counts: Counts, basis: str, wrap: str) -> bool:
    """Whether curves of so many control points can have a cubic basis."""
    if basis not in BASES or not len(counts):
        return False
    if basis == BEZIER:
        least, rest = (3, 0) if wrap == PERIODIC else (4, 1)
        return bool(((counts % 3 == rest) & (counts >= least)).all())
    return bool((counts >= {PERIODIC: 3, PINNED: 2}.get(wrap, 4)).all())


def passes_its_points(basis: str, wrap: str) -> bool:
    """Whether curves pass all of their points."""
    return basis == CATMULL_ROM and wrap == PINNED


def is_dense(counts: Counts) -> bool:
    """Whether curves that pass all of their points have so many that these are the polyline."""
    return bool((counts >= DENSE).all())


def cubic_polylines(points: Points, counts: Counts, basis: str, wrap: str) -> Polylines:
    """Points along cubic curves, and the number of each.

    Args:
        points, counts: control points of all curves one after another, and of each curve; as `is_basis_valid` asks for.
    """
    starts = np.cumsum(counts) - counts
    lines: dict[int, np.ndarray] = {}
    for count in np.unique(counts):
        curves = np.flatnonzero(counts == count)
        control = points[starts[curves][:, None] + np.arange(count)]
        lines |= zip(curves.tolist(), _evaluated(_extended(control, basis, wrap), basis))
    return _joined([lines[curve] for curve in range(len(counts))])


def closed_polylines(points: Points, counts: Counts) -> Polylines:
    """Polylines that end where they begin."""
    ends = np.cumsum(counts)
    return np.insert(points, ends, points[ends - counts], axis=0), counts + 1


def nurbs_polylines(
    points: Points,
    counts: Counts,
    orders: Counts,
    knots: Float[np.ndarray, " k"],
    weights: Float[np.ndarray, " p"] | None,
    source: str,
) -> Polylines:
    """Points along NURBS curves, and the number of each.

    Args:
        knots: of all curves one after another, points + order of each.

    Raises:
        InputError: orders or knots that do not fit the points.
    """
    from scipy.interpolate import BSpline  # takes a part of the time that a file is given

    has_orders = len(orders) == len(counts) and (orders >= 2).all() and (counts >= orders).all()
    if not has_orders or len(knots) != (counts + orders).sum():
        found = f"{len(counts)} curves, {len(orders)} orders, {len(knots)} knots"
        raise InputError(source, "NURBS curves with an order of 2 or more and points + order knots each", found)
    weights = np.ones(len(points)) if weights is None or len(weights) != len(points) else weights
    homogeneous = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
    lines = []
    first, knot = 0, 0
    for count, order in zip(counts.tolist(), orders.tolist()):
        own = knots[knot : knot + count + order]
        low, high = own[order - 1], own[count]
        if (np.diff(own) < 0).any() or not low < high:
            raise InputError(source, "knots that do not decrease", f"{own[:8].tolist()}")
        spans = len(np.unique(own[order - 1 : count + 1])) - 1
        at = np.linspace(low, high, spans * _samples(spans) + 1)
        values = BSpline(own, homogeneous[first : first + count], order - 1, extrapolate=False)(at)
        lines.append(values[:, :3] / values[:, 3:])
        first, knot = first + count, knot + count + order
    return _joined(lines)


def _extended(control: Float[np.ndarray, "s n 3"], basis: str, wrap: str) -> Float[np.ndarray, "s m 3"]:
    """Control points with those that the wrap mode adds."""
    if wrap == PERIODIC:
        return np.concatenate([control, control[:, : 1 if basis == BEZIER else 3]], axis=1)
    if wrap == PINNED and basis != BEZIER:
        before = 2 * control[:, :1] - control[:, 1:2]
        after = 2 * control[:, -1:] - control[:, -2:-1]
        return np.concatenate([before, control, after], axis=1)
    return control


def _evaluated(control: Float[np.ndarray, "s m 3"], basis: str) -> Float[np.ndarray, "s q 3"]:
    step = 3 if basis == BEZIER else 1
    first = np.arange(0, control.shape[1] - 3, step)
    samples = _samples(len(first))
    t = np.arange(samples) / samples
    weights = np.stack([t**3, t**2, t, np.ones(samples)], axis=1) @ BASES[basis]
    segments = control[:, first[:, None] + np.arange(4)]
    along = np.einsum("tc,sgcx->sgtx", weights, segments).reshape(len(control), -1, 3)
    end = np.einsum("c,scx->sx", BASES[basis].sum(0), segments[:, -1])
    return np.concatenate([along, end[:, None]], axis=1)


def _samples(segments: int) -> int:
    return int(np.clip(-(-POINTS_PER_CURVE // max(segments, 1)), FEWEST_PER_SEGMENT, MOST_PER_SEGMENT))


def _joined(lines: list[np.ndarray]) -> Polylines:
    counts = np.array([len(line) for line in lines], dtype=np.int64)
    return np.concatenate([np.empty((0, 3)), *lines]), counts
