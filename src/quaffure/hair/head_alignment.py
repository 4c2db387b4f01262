"""A similarity transform from a groom's own space to ours: units, axes and place guessed, then fitted to the scalp."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

# Metres in one unit of a file.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
# How far the fitted scale may be from a unit's: heads differ, units do not.
SCALE_RANGE = (0.8, 1.25)
# A head in no known unit (decimetres, game units) has to be this much better a fit than one in a known unit.
FREE_UNIT_PENALTY = 1.3
# Robust width of the fit, from the first round to the last [m]: a root further off hardly counts.
WIDTHS = (0.05, 0.015)
COARSE_ROUNDS, FINE_ROUNDS = 12, 30
COARSE_ROOTS, FINE_ROOTS = 300, 1500
BEST_STARTS = 4
# Turns and growth count as movements of a point this far off, so that one damping fits all seven unknowns [m].
HEAD_RADIUS = 0.1
DAMPING = 1e-3
WIDEST_TURN, LONGEST_STEP = 0.3, 0.1  # of one round: rad, and share of the scale
# What uncovered scalp costs against roots off the scalp: a mohawk covers little, and that is right.
COVERAGE_WEIGHT = 0.25
# What it costs when the roots are not their own mirror image; this keeps a mohawk, which little else holds, upright.
SYMMETRY_WEIGHT = 0.5


@dataclass(frozen=True)
class ScalpTarget:
    """Evenly spread points of the scalp to align roots with.

    Attributes:
        points: on the scalp [m].
        normals: unit, outwards.
        rim: whether a point lies at the hairline, beyond which no hair grows.
        tree: over the points.
    """

    points: Float[np.ndarray, "t 3"]
    normals: Float[np.ndarray, "t 3"]
    rim: Int[np.ndarray, " t"]
    tree: cKDTree


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
        unit: name of the unit, or the size of a unit of its own.
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


def scalp_target(
    points: Float[np.ndarray, "t 3"], normals: Float[np.ndarray, "t 3"], rim: Int[np.ndarray, " t"]
) -> ScalpTarget:
    return ScalpTarget(points, normals, rim, cKDTree(points))


def align(roots: Float[np.ndarray, "s 3"], hang: Float[np.ndarray, "3"], target: ScalpTarget) -> Alignment:
    """Fit the roots to the scalp from every plausible unit, up axis and facing, and keep the best.

    Args:
        roots: [file units].
        hang: mean of tip less root over the strands [file units]; hair hangs rather than stands.
        target: our scalp.
    """
    coarse, fine = _thinned(roots, COARSE_ROOTS), _thinned(roots, FINE_ROOTS)
    # Thin the target alike: a coarse round is a few hundred points on both sides.
    sparse = _thinned_target(target, COARSE_ROOTS)
    ranked: list[tuple[float, _Start, Similarity]] = []
    for start in _starts(roots, target):
        transform = _fit(coarse, sparse, start, WIDTHS[0], WIDTHS[0] / 2, COARSE_ROUNDS)
        ranked.append((_cost(transform, coarse, sparse, hang) * start.penalty, start, transform))
    ranked.sort(key=lambda entry: entry[0])
    finished: list[tuple[float, _Start, Similarity]] = []
    for _, start, transform in ranked[:BEST_STARTS]:
        again = _Start(transform, start.unit, start.scale_range, start.penalty)
        transform = _fit(fine, target, again, WIDTHS[0] / 2, WIDTHS[1], FINE_ROUNDS)
        finished.append((_cost(transform, fine, target, hang) * start.penalty, start, transform))
    finished.sort(key=lambda entry: entry[0])
    cost, start, transform = finished[0]
    up = transform.rotation[2]
    axis = int(np.abs(up).argmax())
    unit = start.unit if start.unit in UNITS else f"units of {transform.scale:.2g} m"
    return Alignment(transform, unit, f"{'-+'[int(up[axis] > 0)]}{'xyz'[axis]}", cost / start.penalty)


def refine(
    alignment: Alignment, points: Float[np.ndarray, "p 3"], target: ScalpTarget, scale_range: tuple[float, float]
) -> Alignment:
    """The alignment again, now of other points (a head) to another target (our head), starting from what it is."""
    scale = alignment.transform.scale
    start = _Start(alignment.transform, alignment.unit, (scale_range[0] * scale, scale_range[1] * scale), 1.0)
    transform = _fit(_thinned(points, FINE_ROOTS), target, start, WIDTHS[0] / 2, WIDTHS[1], FINE_ROUNDS)
    return Alignment(transform, alignment.unit, alignment.up_axis, alignment.cost)


def _starts(roots: Float[np.ndarray, "s 3"], target: ScalpTarget) -> list[_Start]:
    size = _spread(target.points) / _spread(roots)
    scales = [(name, metres, 1.0) for name, metres in UNITS.items() if 0.25 < size / metres < 2.0]
    if not any(0.8 < size / metres < 1.25 for _, metres, _ in scales):
        scales.append((f"{size:.2g} m", size, FREE_UNIT_PENALTY))
    starts = []
    for name, scale, penalty in scales:
        for up in (1, 2):
            for turn in range(4):
                rotation = _rotation(up, 0.5 * np.pi * turn)
                translation = target.points.mean(0) - scale * rotation @ np.median(roots, axis=0)
                # Highest points together: a mane down a back has its middle far below the head.
                at_top = translation.copy()
                top = scale * roots @ rotation.T
                highest = top[top[:, 2] >= np.quantile(top[:, 2], 0.8)].mean(0)
                level = target.points[:, 2] >= np.quantile(target.points[:, 2], 0.6)
                at_top = target.points[level].mean(0) - highest
                bounds = (SCALE_RANGE[0] * scale, SCALE_RANGE[1] * scale)
                for shift in (translation, at_top):
                    starts.append(_Start(Similarity(rotation, scale, shift), name, bounds, penalty))
    return starts


def _rotation(up: int, yaw: float) -> Float[np.ndarray, "3 3"]:
    """The rotation that takes the file's y (up = 1) or z (up = 2) to our z, then turns about it."""
    to_z_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if up == 1 else np.eye(3)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]]) @ to_z_up


def _spread(points: Float[np.ndarray, "p 3"]) -> float:
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def _thinned(points: Float[np.ndarray, "p 3"], count: int) -> Float[np.ndarray, "q 3"]:
    """At most `count` points, chosen by place and not by order: every k-th along a coarse space-filling sort."""
    order = np.lexsort(points.T)
    return points[order][:: max(1, len(points) // count)].astype(np.float64)


def _thinned_target(target: ScalpTarget, count: int) -> ScalpTarget:
    kept = np.arange(0, len(target.points), max(1, len(target.points) // count))
    return scalp_target(target.points[kept], target.normals[kept], target.rim[kept])


def _offsets(
    points: Float[np.ndarray, "p 3"], target: ScalpTarget
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p 3"]]:
    """Distance of points from the scalp and the direction in which it grows: its normal, or away from its rim."""
    _, nearest = target.tree.query(points)
    offset = points - target.points[nearest]
    normal = target.normals[nearest]
    height = (offset * normal).sum(1)
    distance = np.linalg.norm(offset, axis=1)
    beyond = target.rim[nearest].astype(bool)
    direction = np.where(beyond[:, None], offset / np.maximum(distance, 1e-9)[:, None], normal)
    return np.where(beyond, distance, height), direction


def _fit(
    roots: Float[np.ndarray, "p 3"], target: ScalpTarget, start: _Start, first: float, last: float, rounds: int
) -> Similarity:
    """Gauss-Newton on the distances of the roots to the scalp, and of the scalp to the roots, robustly weighted.

    Distances rather than pairs of points: roots may slide along the scalp, so rotations converge in few rounds.
    """
    transform = start.transform
    for index in range(rounds):
        width = first * (last / first) ** (index / max(rounds - 1, 1))
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
    """Half way from each root to the root nearest to its mirror image, and how far from that image it is."""
    mismatch, twin = cKDTree(moved).query(moved * [-1.0, 1.0, 1.0])
    return 0.5 * (moved + moved[twin]), mismatch


def _weight(residual: Float[np.ndarray, " p"], width: float) -> Float[np.ndarray, " p"]:
    """Geman and McClure's weights: 1 at zero, vanishing far beyond `width`."""
    return 1.0 / (1.0 + (residual / width) ** 2) ** 2


def _step(
    transform: Similarity,
    anchors: Float[np.ndarray, "q 3"],
    residuals: Float[np.ndarray, " q"],
    directions: Float[np.ndarray, "q 3"],
    weights: Float[np.ndarray, " q"],
    scale_range: tuple[float, float],
) -> Similarity:
    """One damped Gauss-Newton step in translation, rotation and log scale about the middle of the points."""
    centre = anchors.mean(0)
    arms = anchors - centre
    jacobian = np.concatenate(
        [directions, np.cross(arms, directions) / HEAD_RADIUS, (arms * directions).sum(1)[:, None] / HEAD_RADIUS],
        axis=1,
    )
    weighted = jacobian * weights[:, None]
    normal = weighted.T @ jacobian
    step = np.linalg.solve(normal + DAMPING * np.trace(normal) / 7 * np.eye(7), -weighted.T @ residuals)
    vector, growth = step[3:6] / HEAD_RADIUS, float(np.clip(step[6] / HEAD_RADIUS, -LONGEST_STEP, LONGEST_STEP))
    angle = float(np.linalg.norm(vector))
    turn = _axis_angle(vector * min(1.0, WIDEST_TURN / max(angle, 1e-12)))
    scale = float(np.clip(transform.scale * np.exp(growth), *scale_range))
    translation = scale / transform.scale * turn @ (transform.translation - centre) + centre + step[:3]
    return Similarity(turn @ transform.rotation, scale, translation)


def _axis_angle(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _cost(
    transform: Similarity, roots: Float[np.ndarray, "p 3"], target: ScalpTarget, hang: Float[np.ndarray, "3"]
) -> float:
    """Robust misfit of roots and of uncovered scalp; hair that points upwards on the whole is a little less likely."""
    moved = transform(roots)
    width = WIDTHS[0] / 2
    off = 1 - np.sqrt(_weight(np.linalg.norm(moved - target.points[target.tree.query(moved)[1]], axis=1), width))
    bald = 1 - np.sqrt(_weight(cKDTree(moved).query(target.points)[0], width))
    rise = float((transform.rotation @ hang)[2] / max(np.linalg.norm(hang), 1e-12))
    return float(off.mean() + COVERAGE_WEIGHT * bald.mean() + 0.01 * rise)
