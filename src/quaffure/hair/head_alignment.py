"""Similarity transform from a groom's own frame to ours: units, axes and position estimated by a fit to the scalp.

Roots that cover a part of a scalp fit almost as well pitched by 30 degrees, so each fit is made free and also held
upright, by the file's axis and by the direction in which the hair hangs. A free fit must be clearly better to be kept.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from quaffure.geometry.axes import axis_name
from quaffure.hair.file_frame import UNITS, FileFrame
from quaffure.hair.scalp_target import ScalpTarget

# Range of the fitted scale relative to a unit's: heads differ, units do not.
SCALE_RANGE = (0.8, 1.25)
# Factor on the cost of a fit in no known unit (decimetres, game units).
FREE_UNIT_PENALTY = 1.3
# Width of the robust weight, from the first round to the last [m]: a root further off hardly counts.
COARSE_WIDTHS, FINE_WIDTHS = (0.05, 0.025), (0.025, 0.015)
COARSE_ROUNDS, FINE_ROUNDS = 12, 30
COARSE_ROOTS, FINE_ROOTS = 300, 1500
BEST_STARTS = 4
# After so many of the fine rounds, fits that cost so many times more than the best one, or than what is asked for, end.
TRIAL_ROUNDS, HOPELESS = 10, 1.3
# Rotation and scale are measured as motion at this distance [m], so that one damping suits all seven unknowns.
HEAD_RADIUS = 0.1
DAMPING = 1e-3
LARGEST_ROTATION, LARGEST_SCALE_STEP = 0.3, 0.1  # of one round: rad, and logarithm of the scale
# Weight of uncovered scalp relative to roots off the scalp; low, because a mohawk covers little.
COVERAGE_WEIGHT = 0.25
# Weight of the deviation from mirror symmetry; it determines the roll of a mohawk.
SYMMETRY_WEIGHT = 0.5
# Weight of the tilt relative to roots off the scalp, where a fit is held upright.
UPRIGHT_WEIGHT = 0.06
# A fit that is not held upright costs more where much of the scalp stays uncovered: a full head of hair tells its
# pitch, whereas a cap of roots on a head of another form fits 1.1 times better when pitched by 25 degrees.
TILT_PENALTY, MOST_TILT_PENALTY = 5.0, 0.2
# Hair hangs where the mean of its unit directions is longer than this; it then hangs down within 15 degrees.
COHERENT_HANG, HANG_ERROR = 0.9, np.radians(15.0)
# Gravity against the file's axis has to be a little better: hair is combed, files seldom lie askew.
GRAVITY_PENALTY = 1.03
# Cost of a root on the lower face, where off the scalp and the face it is 1: beards are rare.
FACE_COST = 0.15


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
    file_up: Float[np.ndarray, "3"]
    upright: Float[np.ndarray, "3"] | None = None  # direction of the file that is held upright
    is_free: bool = False  # whether others are held


def align(
    roots: Float[np.ndarray, "s 3"],
    hang: Float[np.ndarray, "3"],
    target: ScalpTarget,
    frame: FileFrame,
    highest_cost: float = np.inf,
) -> Alignment:
    """Fit the roots to the scalp from every plausible unit, up axis and facing, and keep the best.

    Args:
        roots: [file units].
        hang: mean over the strands of the unit direction of their outer part; hair hangs rather than stands.
        target: our scalp.
        frame: what is known of the file; it is not tried otherwise.
        highest_cost: a fit that costs clearly more is of no use, and stays a rough one.
    """
    sparse, coarse_widths = target.thinned(COARSE_ROOTS), _widths(COARSE_WIDTHS, COARSE_ROUNDS)
    ranked = _ranked(_starts(roots, target, frame), _thinned(roots, COARSE_ROOTS), sparse, hang, coarse_widths)
    upright = bool(frame.up)
    best = [variant for _, start in ranked[:BEST_STARTS] for variant in _tilts(start, hang, upright)]
    points, widths = _thinned(roots, FINE_ROOTS), _widths(FINE_WIDTHS, FINE_ROUNDS)
    tried = _ranked(best, points, target, hang, widths[:TRIAL_ROUNDS])
    best_cost = tried[0][0]
    likely = max(HOPELESS * best_cost, best_cost)  # below 0, the reward of hanging hair outweighs the misfit
    hopeful = [start for cost, start in tried if cost <= likely and cost < HOPELESS * start.penalty * highest_cost]
    cost, start = _ranked(hopeful, points, target, hang, widths[TRIAL_ROUNDS:])[0] if hopeful else tried[0]
    transform = start.transform
    size = frame.units or f"{transform.scale:.2g}"
    unit = start.unit if start.unit in UNITS else f"units of {size} m"
    return Alignment(transform, unit, axis_name(transform.rotation[2]), max(cost, 0.0) / start.penalty)


def _tilts(start: _Start, hang: Float[np.ndarray, "3"], is_up_known: bool) -> list[_Start]:
    """The start held upright, by the file's axis; where that is a guess, also by gravity and free to tilt."""
    held = [replace(start, upright=start.file_up)]
    if is_up_known:
        return held
    # Hair falls to one side of a parting: of the side, symmetry knows more.
    side = start.transform.rotation[0]
    up = hang @ side * side - hang
    length = float(np.linalg.norm(up))
    if np.linalg.norm(hang) > COHERENT_HANG and up @ start.file_up < length * np.cos(HANG_ERROR):
        held.append(replace(start, upright=up / length, penalty=GRAVITY_PENALTY * start.penalty))
    return [*held, replace(start, is_free=True)]


def _ranked(
    starts: list[_Start],
    points: Float[np.ndarray, "p 3"],
    target: ScalpTarget,
    hang: Float[np.ndarray, "3"],
    widths: list[float],
) -> list[tuple[float, _Start]]:
    """The starts with fitted transforms and their penalized costs, best first."""
    fitted = [replace(start, transform=_fit(points, target, start, widths)) for start in starts]
    costs = [_cost(start, points, target, hang) for start in fitted]
    return sorted(zip(costs, fitted), key=lambda entry: entry[0])


def refine(
    alignment: Alignment, points: Float[np.ndarray, "p 3"], target: ScalpTarget, scale_range: tuple[float, float]
) -> Alignment:
    """The alignment refined with other points (a head) and another target (our head)."""
    scale = alignment.transform.scale
    bounds = (scale_range[0] * scale, scale_range[1] * scale)
    start = _Start(alignment.transform, alignment.unit, bounds, 1.0, alignment.transform.rotation[2])
    transform = _fit(_thinned(points, FINE_ROOTS), target, start, _widths(FINE_WIDTHS, FINE_ROUNDS))
    return replace(alignment, transform=transform)


def misfit(transform: Similarity, points: Float[np.ndarray, "p 3"], target: ScalpTarget) -> Float[np.ndarray, " p"]:
    """Distance of points [file units], once transformed, from the surface of the target [m]."""
    return np.abs(_offsets(transform(points), target)[0])


def _starts(roots: Float[np.ndarray, "s 3"], target: ScalpTarget, frame: FileFrame) -> list[_Start]:
    scalp = target.scalp_points
    size = _spread(scalp) / _spread(roots)
    scales = [(name, metres, 1.0) for name, metres in UNITS.items() if 0.25 < size / metres < 2.0]
    if frame.units:
        scales = [(frame.units, frame.metres_per_unit(), 1.0)]
    elif not any(0.8 < size / metres < 1.25 for _, metres, _ in scales):
        scales.append((f"{size:.2g} m", size, FREE_UNIT_PENALTY))
    starts = []
    for name, scale, penalty in scales:
        for rotation in frame.rotations():
            translation = scalp.mean(0) - scale * rotation @ np.median(roots, axis=0)
            # Alternative start, highest points together: the centroid of a mane is far below the head.
            top = scale * roots @ rotation.T
            highest = top[top[:, 2] >= np.quantile(top[:, 2], 0.8)].mean(0)
            level = scalp[:, 2] >= np.quantile(scalp[:, 2], 0.6)
            at_top = scalp[level].mean(0) - highest
            bounds = (SCALE_RANGE[0] * scale, SCALE_RANGE[1] * scale)
            for shift in (translation, at_top):
                starts.append(_Start(Similarity(rotation, scale, shift), name, bounds, penalty, rotation[2]))
    return starts


def _spread(points: Float[np.ndarray, "p 3"]) -> float:
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def _thinned(points: Float[np.ndarray, "p 3"], count: int) -> Float[np.ndarray, "q 3"]:
    """At most about `count` points: every k-th in lexicographic order, independent of the order in the file."""
    order = np.lexsort(points.T)
    return points[order][:: max(1, len(points) // count)].astype(np.float64)


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


def _widths(ends: tuple[float, float], rounds: int) -> list[float]:
    """Width of the robust weight in each round, falling by the same factor."""
    return [ends[0] * (ends[1] / ends[0]) ** (index / max(rounds - 1, 1)) for index in range(rounds)]


def _fit(roots: Float[np.ndarray, "p 3"], target: ScalpTarget, start: _Start, widths: list[float]) -> Similarity:
    """Gauss-Newton on the distances of the roots to the scalp, and of the scalp to the roots, robustly weighted.

    Point-to-plane distances rather than pairs of points: rotations converge in few rounds.

    Args:
        widths: of the robust weight, one a round [m].
    """
    transform = start.transform
    for width in widths:
        moved = transform(roots)
        residual, direction = _offsets(moved, target)
        tree = cKDTree(moved)
        gap, nearest = tree.query(target.scalp_points)
        back = moved[nearest] - target.scalp_points
        back_direction = back / np.maximum(gap, 1e-9)[:, None]
        midpoint, mismatch = _mirrored(moved, tree)
        anchors = np.concatenate([moved, moved[nearest], midpoint])
        residuals = np.concatenate([residual, gap, midpoint[:, 0]])
        directions = np.concatenate([direction, back_direction, np.tile([1.0, 0.0, 0.0], (len(midpoint), 1))])
        share = COVERAGE_WEIGHT * len(roots) / len(gap)
        weights = np.concatenate(
            [_weight(residual, width), share * _weight(gap, width), SYMMETRY_WEIGHT * _weight(mismatch, width)]
        )
        centre = anchors.mean(0)
        jacobian = _jacobian(anchors - centre, directions)
        if start.upright is not None:
            held, tilt = _tilt(transform.rotation @ start.upright)
            jacobian, residuals = np.concatenate([jacobian, held]), np.concatenate([residuals, tilt])
            weights = np.concatenate([weights, np.full(2, UPRIGHT_WEIGHT * len(roots))])
        transform = _step(transform, centre, jacobian, residuals, weights, start.scale_range)
    return transform


def _jacobian(arms: Float[np.ndarray, "q 3"], directions: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 7"]:
    """Motion along `directions` by translation, rotation and log scale about the origin of `arms`."""
    scaling = (arms * directions).sum(1)[:, None]
    return np.concatenate([directions, np.cross(arms, directions) / HEAD_RADIUS, scaling / HEAD_RADIUS], axis=1)


def _tilt(up: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "2 7"], Float[np.ndarray, "2"]]:
    """Jacobian and residual of a unit vector's horizontal part, as motion at `HEAD_RADIUS` [m]."""
    jacobian = np.zeros((2, 7))
    jacobian[:, 3:6] = np.cross(up, np.eye(3)[:2])
    return jacobian, HEAD_RADIUS * up[:2]


def _mirrored(
    moved: Float[np.ndarray, "p 3"], tree: cKDTree
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Midpoint of each root and the root nearest to its mirror image, and the distance of that root from the image."""
    mismatch, twin = tree.query(moved * [-1.0, 1.0, 1.0])
    return 0.5 * (moved + moved[twin]), mismatch


def _weight(residual: Float[np.ndarray, " p"], width: float) -> Float[np.ndarray, " p"]:
    """Geman-McClure weights: 1 at zero, vanishing far beyond `width`."""
    return 1.0 / (1.0 + (residual / width) ** 2) ** 2


def _step(
    transform: Similarity,
    centre: Float[np.ndarray, "3"],
    jacobian: Float[np.ndarray, "q 7"],
    residuals: Float[np.ndarray, " q"],
    weights: Float[np.ndarray, " q"],
    scale_range: tuple[float, float],
) -> Similarity:
    """One damped Gauss-Newton step in translation, rotation and log scale about `centre`."""
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


def _cost(start: _Start, roots: Float[np.ndarray, "p 3"], target: ScalpTarget, hang: Float[np.ndarray, "3"]) -> float:
    """Robust misfit of roots and of uncovered scalp, with a small penalty on hair that points upwards on average."""
    moved = start.transform(roots)
    width = FINE_WIDTHS[0]
    distance, nearest = target.tree.query(moved)
    off = 1 - np.sqrt(_weight(distance, width))
    off = np.where(target.face[nearest], FACE_COST + (1 - FACE_COST) * off, off)
    bald = float((1 - np.sqrt(_weight(cKDTree(moved).query(target.scalp_points)[0], width))).mean())
    rise = float((start.transform.rotation @ hang)[2])
    tilt_penalty = 1 + min(TILT_PENALTY * bald**2, MOST_TILT_PENALTY) if start.is_free else 1.0
    return float(off.mean() + COVERAGE_WEIGHT * bald + 0.01 * rise) * start.penalty * tilt_penalty
