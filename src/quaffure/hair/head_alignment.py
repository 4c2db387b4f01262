"""Similarity transform from a groom's own frame to ours: units, axes and position estimated by a fit to the scalp."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

# Metres in one unit of a file.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
# Range of the fitted scale relative to a unit's: heads differ, units do not.
SCALE_RANGE = (0.8, 1.25)
# Factor on the cost of a fit in no known unit (decimetres, game units).
FREE_UNIT_PENALTY = 1.3
# Width of the robust weight, from the first round to the last [m]: a root further off hardly counts.
COARSE_WIDTHS, FINE_WIDTHS = (0.05, 0.025), (0.025, 0.015)
COARSE_ROUNDS, FINE_ROUNDS = 12, 30
COARSE_ROOTS, FINE_ROOTS = 300, 1500
BEST_STARTS = 4
# Rotation and scale are measured as motion at this distance [m], so that one damping suits all seven unknowns.
HEAD_RADIUS = 0.1
DAMPING = 1e-3
LARGEST_ROTATION, LARGEST_SCALE_STEP = 0.3, 0.1  # of one round: rad, and logarithm of the scale
# Weight of uncovered scalp relative to roots off the scalp; low, because a mohawk covers little.
COVERAGE_WEIGHT = 0.25
# Weight of the deviation from mirror symmetry; it determines the roll of a mohawk.
SYMMETRY_WEIGHT = 0.5


@dataclass(frozen=True)
class ScalpTarget:
    """Evenly distributed points of the scalp to align roots with.

    Attributes:
        points: on the scalp [m].
        normals: unit, outwards.
        rim: whether a point lies at the hairline, beyond which there is no hair.
    """

    points: Float[np.ndarray, "t 3"]
    normals: Float[np.ndarray, "t 3"]
    rim: Bool[np.ndarray, " t"]

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)


@dataclass(frozen=True)
class Similarity:
    """x -> scale * rotation @ x + translation, from file units to metres in our world.

    Attributes:
        rotation: a proper rotation.
        scale: metres in a file unit.
        translation: [m].
    """

    rotation: Float[np.ndarray, "3 3"]
    scale: float
    translation: Float[np.ndarray, "3"]

    def __call__(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        return self.scale * points.astype(np.float64) @ self.rotation.T + self.translation


@dataclass(frozen=True)
class Alignment:
    """The best fit found.

    Attributes:
        transform: from the file to our body.
        unit: name of the unit, or its size where it has none.
        up_axis: the file's axis that points up, as in "+y".
        cost: robust mean misfit, 0 (perfect) to about 1.
    """

    transform: Similarity
    unit: str
    up_axis: str
    cost: float


@dataclass(frozen=True)
class _Start:
    transform: Similarity
    unit: str
    scale_range: tuple[float, float]
    penalty: float


def align(roots: Float[np.ndarray, "s 3"], hang: Float[np.ndarray, "3"], target: ScalpTarget) -> Alignment:
    """Fit the roots to the scalp from every plausible unit, up axis and facing, and keep the best.

    Args:
        roots: [file units].
        hang: mean of tip less root over the strands [file units]; hair hangs rather than stands.
        target: our scalp.
    """
    sparse = _thinned_target(target, COARSE_ROOTS)
    ranked = _ranked(_starts(roots, target), _thinned(roots, COARSE_ROOTS), sparse, hang, COARSE_WIDTHS, COARSE_ROUNDS)
    best = [start for _, start in ranked[:BEST_STARTS]]
    cost, start = _ranked(best, _thinned(roots, FINE_ROOTS), target, hang, FINE_WIDTHS, FINE_ROUNDS)[0]
    transform = start.transform
    up = transform.rotation[2]
    axis = int(np.abs(up).argmax())
    unit = start.unit if start.unit in UNITS else f"units of {transform.scale:.2g} m"
    return Alignment(transform, unit, f"{'-+'[int(up[axis] > 0)]}{'xyz'[axis]}", cost / start.penalty)


def _ranked(
    starts: list[_Start],
    points: Float[np.ndarray, "p 3"],
    target: ScalpTarget,
    hang: Float[np.ndarray, "3"],
    widths: tuple[float, float],
    rounds: int,
) -> list[tuple[float, _Start]]:
    """The starts with fitted transforms and their penalized costs, best first."""
    fitted = [replace(start, transform=_fit(points, target, start, widths, rounds)) for start in starts]
    costs = [_cost(start.transform, points, target, hang) * start.penalty for start in fitted]
    return sorted(zip(costs, fitted), key=lambda entry: entry[0])


def refine(
    alignment: Alignment, points: Float[np.ndarray, "p 3"], target: ScalpTarget, scale_range: tuple[float, float]
) -> Alignment:
    """The alignment refined with other points (a head) and another target (our head)."""
    scale = alignment.transform.scale
    start = _Start(alignment.transform, alignment.unit, (scale_range[0] * scale, scale_range[1] * scale), 1.0)
    transform = _fit(_thinned(points, FINE_ROOTS), target, start, FINE_WIDTHS, FINE_ROUNDS)
    return replace(alignment, transform=transform)


def _starts(roots: Float[np.ndarray, "s 3"], target: ScalpTarget) -> list[_Start]:
    size = _spread(target.points) / _spread(roots)
    scales = [(name, metres, 1.0) for name, metres in UNITS.items() if 0.25 < size / metres < 2.0]
    if not any(0.8 < size / metres < 1.25 for _, metres, _ in scales):
        scales.append((f"{size:.2g} m", size, FREE_UNIT_PENALTY))
    starts = []
    for name, scale, penalty in scales:
        for up in (1, 2):
            for quarter in range(4):
                rotation = _rotation(up, 0.5 * np.pi * quarter)
                translation = target.points.mean(0) - scale * rotation @ np.median(roots, axis=0)
                # Alternative start, highest points together: the centroid of a mane is far below the head.
                top = scale * roots @ rotation.T
                highest = top[top[:, 2] >= np.quantile(top[:, 2], 0.8)].mean(0)
                level = target.points[:, 2] >= np.quantile(target.points[:, 2], 0.6)
                at_top = target.points[level].mean(0) - highest
                bounds = (SCALE_RANGE[0] * scale, SCALE_RANGE[1] * scale)
                for shift in (translation, at_top):
                    starts.append(_Start(Similarity(rotation, scale, shift), name, bounds, penalty))
    return starts


def _rotation(up: int, yaw: float) -> Float[np.ndarray, "3 3"]:
    """The rotation from the file's y (up = 1) or z (up = 2) to our z, followed by one about z."""
    to_z_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if up == 1 else np.eye(3)
    return Rotation.from_euler("z", yaw).as_matrix() @ to_z_up


def _spread(points: Float[np.ndarray, "p 3"]) -> float:
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def _thinned(points: Float[np.ndarray, "p 3"], count: int) -> Float[np.ndarray, "q 3"]:
    """At most about `count` points: every k-th in lexicographic order, independent of the order in the file."""
    order = np.lexsort(points.T)
    return points[order][:: max(1, len(points) // count)].astype(np.float64)


def _thinned_target(target: ScalpTarget, count: int) -> ScalpTarget:
    kept = np.arange(0, len(target.points), max(1, len(target.points) // count))
    return ScalpTarget(target.points[kept], target.normals[kept], target.rim[kept])


def _offsets(
    points: Float[np.ndarray, "p 3"], target: ScalpTarget
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p 3"]]:
    """Distance of points from the scalp and its gradient: the normal, or away from the rim beyond it."""
    _, nearest = target.tree.query(points)
    offset = points - target.points[nearest]
    normal = target.normals[nearest]
    height = (offset * normal).sum(1)
    distance = np.linalg.norm(offset, axis=1)
    beyond = target.rim[nearest]
    direction = np.where(beyond[:, None], offset / np.maximum(distance, 1e-9)[:, None], normal)
    return np.where(beyond, distance, height), direction


def _fit(
    roots: Float[np.ndarray, "p 3"], target: ScalpTarget, start: _Start, widths: tuple[float, float], rounds: int
) -> Similarity:
    """Gauss-Newton on the distances of the roots to the scalp, and of the scalp to the roots, robustly weighted.

    Point-to-plane distances rather than pairs of points: rotations converge in few rounds.
    """
    transform = start.transform
    for index in range(rounds):
        width = widths[0] * (widths[1] / widths[0]) ** (index / max(rounds - 1, 1))
        moved = transform(roots)
        residual, direction = _offsets(moved, target)
        gap, nearest = cKDTree(moved).query(target.points)
        back = moved[nearest] - target.points
        back_direction = back / np.maximum(gap, 1e-9)[:, None]
        midpoint, mismatch = _mirrored(moved)
        anchors = np.concatenate([moved, moved[nearest], midpoint])
        residuals = np.concatenate([residual, gap, midpoint[:, 0]])
        directions = np.concatenate([direction, back_direction, np.tile([1.0, 0.0, 0.0], (len(midpoint), 1))])
        share = COVERAGE_WEIGHT * len(roots) / len(gap)
        weights = np.concatenate(
            [_weight(residual, width), share * _weight(gap, width), SYMMETRY_WEIGHT * _weight(mismatch, width)]
        )
        transform = _step(transform, anchors, residuals, directions, weights, start.scale_range)
    return transform


def _mirrored(moved: Float[np.ndarray, "p 3"]) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Midpoint of each root and the root nearest to its mirror image, and the distance of that root from the image."""
    mismatch, twin = cKDTree(moved).query(moved * [-1.0, 1.0, 1.0])
    return 0.5 * (moved + moved[twin]), mismatch


def _weight(residual: Float[np.ndarray, " p"], width: float) -> Float[np.ndarray, " p"]:
    """Geman-McClure weights: 1 at zero, vanishing far beyond `width`."""
    return 1.0 / (1.0 + (residual / width) ** 2) ** 2


def _step(
    transform: Similarity,
    anchors: Float[np.ndarray, "q 3"],
    residuals: Float[np.ndarray, " q"],
    directions: Float[np.ndarray, "q 3"],
    weights: Float[np.ndarray, " q"],
    scale_range: tuple[float, float],
) -> Similarity:
    """One damped Gauss-Newton step in translation, rotation and log scale about the centroid of the points."""
    centre = anchors.mean(0)
    arms = anchors - centre
    jacobian = np.concatenate(
        [directions, np.cross(arms, directions) / HEAD_RADIUS, (arms * directions).sum(1)[:, None] / HEAD_RADIUS],
        axis=1,
    )
    weighted = jacobian * weights[:, None]
    normal = weighted.T @ jacobian
    step = np.linalg.solve(normal + DAMPING * np.trace(normal) / 7 * np.eye(7), -weighted.T @ residuals)
    vector = step[3:6] / HEAD_RADIUS
    vector *= min(1.0, LARGEST_ROTATION / max(float(np.linalg.norm(vector)), 1e-12))
    rotation = Rotation.from_rotvec(vector).as_matrix()
    log_scale = np.clip(step[6] / HEAD_RADIUS, -LARGEST_SCALE_STEP, LARGEST_SCALE_STEP)
    scale = float(np.clip(transform.scale * np.exp(log_scale), *scale_range))
    translation = scale / transform.scale * rotation @ (transform.translation - centre) + centre + step[:3]
    return Similarity(rotation @ transform.rotation, scale, translation)


def _cost(
    transform: Similarity, roots: Float[np.ndarray, "p 3"], target: ScalpTarget, hang: Float[np.ndarray, "3"]
) -> float:
    """Robust misfit of roots and of uncovered scalp, with a small penalty on hair that points upwards on average."""
    moved = transform(roots)
    width = FINE_WIDTHS[0]
    off = 1 - np.sqrt(_weight(np.linalg.norm(moved - target.points[target.tree.query(moved)[1]], axis=1), width))
    bald = 1 - np.sqrt(_weight(cKDTree(moved).query(target.points)[0], width))
    rise = float((transform.rotation @ hang)[2] / max(np.linalg.norm(hang), 1e-12))
    return float(off.mean() + COVERAGE_WEIGHT * bald.mean() + 0.01 * rise)
