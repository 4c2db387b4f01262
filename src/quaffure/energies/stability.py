"""Least stiffness at which a groom's design is a minimum of the energy and not only in balance.

Hair longer than about 10 cm can't stand on its root (Greenhill), and a tail bent sharply under its own weight buckles:
balanced by a preload, such strands would fall from the design at the first push. From tip to root, the second
derivative of the energy by the rotations of edges is eliminated; where what is left for an edge is not positive
definite, the strand from there on would fall even if it were clamped there, and is made stiffer, until it would not.

Per edge three rotations, of its material frame. Per joint i, with M_i the moment that it transmits (see
`quaffure.energies.sag_free`), the derivative of M_i by the rotation of edge i is K_i; that by the rotation of edge
i - 1 follows, since rotating both rotates M_i. Forces on the vertices act through the edges' lever arms, contact with
its stiffness 6 k s along the normal (Eq. 10).
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.energies.rod import LEAST_ALIGNMENT
from quaffure.energies.rod_kernels import Vector, cross, dot, transported
from quaffure.energies.support import _row
from quaffure.geometry.symmetric_matrix import symmetric_inverse, symmetric_times

STEP = 1e-5
"""Rotation for central differences of a joint's moment [rad]."""
GROWTH = 0.2
"""By which share an unstable part becomes stiffer at a time at its clamp; beyond, in proportion to the weight there."""
MOST_TRIALS = 40
MARGIN = 0.05
"""Least second derivative left for an edge, in units of lifting its end vertex by its length."""


class Design(NamedTuple):
    """What acts on the strands of the design at balance.

    Attributes:
        strands, direction, weight, normal, held, bending_stiffness, twisting_stiffness: see `StrandForces`.
        support: of every vertex [N].
        contact_stiffness: second derivative of Eq. 10 at every vertex [N/m].
        bending, twisting: moments that each joint transmits [N m].
        goal: pull of each held edge's goal on its direction [J].
    """

    strands: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    normal: np.ndarray
    held: np.ndarray
    bending_stiffness: np.ndarray
    twisting_stiffness: np.ndarray
    support: np.ndarray
    contact_stiffness: np.ndarray
    bending: np.ndarray
    twisting: np.ndarray
    goal: np.ndarray


@njit(cache=True, inline="always")
def _rotated(v: Vector, axis: int, angle: float) -> Vector:
    """A vector rotated about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == 0:
        return v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]
    if axis == 1:
        return c * v[0] + s * v[2], v[1], c * v[2] - s * v[0]
    return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]


@njit(cache=True)
def _joint_moment(
    before: Vector,
    normal: Vector,
    edge: Vector,
    edge_normal: Vector,
    rest: tuple[float, ...],
    stiffness: tuple[float, float],
) -> Vector:
    """Moment M that a joint transmits between the material frames of two edges [N m].

    Args:
        before, normal: direction and material normal of the edge before.
        edge, edge_normal: of the edge.
        rest: rest direction in the frame before (three components), rest twist.
        stiffness: B and C [J].
    """
    moved = transported(normal, before, edge)
    twist = np.arctan2(dot(edge_normal, cross(edge, moved)), dot(edge_normal, moved))
    cosine, sine = np.cos(0.5 * twist), np.sin(0.5 * twist)
    across, aside = rest[1] * cosine - rest[2] * sine, rest[1] * sine + rest[2] * cosine
    binormal = cross(before, normal)
    target = (
        rest[0] * before[0] + across * normal[0] + aside * binormal[0],
        rest[0] * before[1] + across * normal[1] + aside * binormal[1],
        rest[0] * before[2] + across * normal[2] + aside * binormal[2],
    )
    bent = cross(target, edge)
    bending = (stiffness[0] * bent[0], stiffness[0] * bent[1], stiffness[0] * bent[2])
    share = stiffness[1] * (twist - rest[3]) - 0.5 * dot(before, bending)
    share /= max(1 + dot(before, edge), LEAST_ALIGNMENT)
    return (
        bending[0] + share * (before[0] + edge[0]),
        bending[1] + share * (before[1] + edge[1]),
        bending[2] + share * (before[2] + edge[2]),
    )


@njit(cache=True)
def _rest_at(
    design: Design, strand: int, edge: int, normal: Vector, factor: float
) -> tuple[tuple[float, ...], tuple[float, float]]:
    """Rest direction and twist of a joint `factor` times as stiff that transmits the design's moments, and B and C."""
    bending = factor * design.bending_stiffness[strand, edge]
    twisting = factor * design.twisting_stiffness[strand, edge]
    direction = _row(design.direction[strand], edge)
    before = _row(design.direction[strand], max(edge - 1, 0))
    moment = _row(design.bending[strand], edge)
    lean = cross(direction, (moment[0] / bending, moment[1] / bending, moment[2] / bending))
    along = np.sqrt(max(1 - dot(lean, lean), 0.0))
    p = (along * direction[0] + lean[0], along * direction[1] + lean[1], along * direction[2] + lean[2])
    rest = (dot(p, before), dot(p, normal), dot(p, cross(before, normal)), -design.twisting[strand, edge] / twisting)
    return rest, (bending, twisting)


@njit(cache=True)
def _fill_joint(design: Design, strand: int, edge: int, normal: Vector, factor: float, derivative: np.ndarray) -> None:
    """K of a joint: derivative of its moment by the rotation of the edge beyond, by central differences."""
    direction = _row(design.direction[strand], edge)
    before = _row(design.direction[strand], max(edge - 1, 0))
    own = transported(normal, before, direction)
    rest, stiffness = _rest_at(design, strand, edge, normal, factor)
    for axis in range(3):
        plus = _joint_moment(
            before, normal, _rotated(direction, axis, STEP), _rotated(own, axis, STEP), rest, stiffness
        )
        minus = _joint_moment(
            before, normal, _rotated(direction, axis, -STEP), _rotated(own, axis, -STEP), rest, stiffness
        )
        for row in range(3):
            derivative[row, axis] = (plus[row] - minus[row]) / (2 * STEP)


@njit(cache=True)
def _fill_loads(design: Design, strand: int, hessian: np.ndarray) -> None:
    """Second derivatives of the potential of weight, support and goals by the rotations of edges."""
    x, directions = design.strands[strand], design.direction[strand]
    edges = len(directions)
    hessian[:] = 0.0
    fx, fy, fz = 0.0, 0.0, 0.0
    for edge in range(edges - 1, -1, -1):
        push = design.support[strand, edge + 1]
        fx += push * design.normal[strand, edge + 1, 0]
        fy += push * design.normal[strand, edge + 1, 1]
        fz += push * design.normal[strand, edge + 1, 2] - design.weight[strand, edge + 1]
        length, goal, t = _length(x, edge), design.goal[strand, edge], directions[edge]
        pull = (length * fx + goal[0], length * fy + goal[1], length * fz + goal[2])
        along = pull[0] * t[0] + pull[1] * t[1] + pull[2] * t[2]
        for a in range(3):
            hessian[3 * edge + a, 3 * edge + a] += along
            for b in range(3):
                hessian[3 * edge + a, 3 * edge + b] -= 0.5 * (pull[a] * t[b] + t[a] * pull[b])
    _add_contact(design, strand, hessian)


@njit(cache=True)
def _add_contact(design: Design, strand: int, hessian: np.ndarray) -> None:
    x, edges = design.strands[strand], len(design.direction[strand])
    arms = np.empty(3 * edges)
    for vertex in range(1, edges + 1):
        stiffness = design.contact_stiffness[strand, vertex]
        if stiffness <= 0:
            continue
        normal = _row(design.normal[strand], vertex)
        for edge in range(vertex):
            step = (x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1], x[edge + 1, 2] - x[edge, 2])
            arms[3 * edge], arms[3 * edge + 1], arms[3 * edge + 2] = cross(step, normal)
        for a in range(3 * vertex):
            for b in range(3 * vertex):
                hessian[a, b] += stiffness * arms[a] * arms[b]


@njit(cache=True, inline="always")
def _length(x: np.ndarray, edge: int) -> float:
    """Length of an edge between vertices [m]."""
    a, b, c = x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1], x[edge + 1, 2] - x[edge, 2]
    return np.sqrt(a * a + b * b + c * c)


@njit(cache=True, inline="always")
def _is_definite(m: np.ndarray, at: int, least: float) -> bool:
    """Whether all eigenvalues of a symmetric 3 x 3 block on the diagonal are above `least`: its leading minors are
    positive."""
    a, b, c = m[at, at] - least, m[at + 1, at + 1] - least, m[at + 2, at + 2] - least
    d, e, f = m[at, at + 1], m[at, at + 2], m[at + 1, at + 2]
    minor = a * b - d * d
    return a > 0 and minor > 0 and c * minor - a * f * f - b * e * e + 2 * d * e * f > 0


@njit(cache=True)
def _eliminate(hessian: np.ndarray, edge: int) -> None:
    """Removes an edge's rotation from the second derivatives of the edges before it."""
    i = 3 * edge
    own = (
        hessian[i, i],
        hessian[i + 1, i],
        hessian[i + 1, i + 1],
        hessian[i + 2, i],
        hessian[i + 2, i + 1],
        hessian[i + 2, i + 2],
    )
    inverse = symmetric_inverse(own, 0.0)
    for a in range(i):
        weights = symmetric_times(inverse, (hessian[i, a], hessian[i + 1, a], hessian[i + 2, a]))
        for b in range(i):
            hessian[a, b] -= (
                weights[0] * hessian[i, b] + weights[1] * hessian[i + 1, b] + weights[2] * hessian[i + 2, b]
            )


@njit(cache=True, parallel=True)
def stable_factors(design: Design, factors: np.ndarray, unstable: np.ndarray) -> None:
    """How many times stiffer than in `design` each joint has to be, written to `factors`; 1 where it is not.

    `unstable` becomes true for strands that are not stable after `MOST_TRIALS`.
    """
    for index in prange(len(factors)):
        # The index of a parallel loop has two types, for each of which numba would compile all that is called.
        strand: Any = np.int64(index)
        unstable[strand] = not _find_factors(design, strand, factors[strand])


@njit(cache=True)
def _find_factors(design: Design, strand: int, factors: np.ndarray) -> bool:
    """Fills the factors of one strand; whether it is stable with them."""
    edges, directions = len(factors), design.direction[strand]
    loads, hessian, normals = np.empty((3 * edges, 3 * edges)), np.empty((3 * edges, 3 * edges)), np.empty((edges, 3))
    _fill_normals(directions, normals)
    _fill_loads(design, strand, loads)
    factors[:] = 1.0
    beyond = np.empty(edges)
    weight = 0.0
    for edge in range(edges - 1, -1, -1):
        weight += design.weight[strand, edge + 1]
        beyond[edge] = weight
    for trial in range(MOST_TRIALS + 1):
        for row in range(3 * edges):
            for column in range(3 * edges):
                hessian[row, column] = loads[row, column]
        unstable = _first_unstable(design, strand, normals, factors, hessian)
        if unstable < 0:
            return True
        if trial < MOST_TRIALS:
            for edge in range(unstable, edges):
                factors[edge] *= 1 + GROWTH * beyond[edge] / beyond[unstable]
    return False


@njit(cache=True)
def _first_unstable(design: Design, strand: int, normals: np.ndarray, factors: np.ndarray, hessian: np.ndarray) -> int:
    """The edge, from tip to root, up to which the strand is stable no more if clamped before it; -1 for none."""
    x, derivative = design.strands[strand], np.empty((3, 3))
    for edge in range(len(factors) - 1, -1, -1):
        at, before = 3 * edge, 3 * edge - 3
        _fill_joint(design, strand, edge, _row(normals, edge), factors[edge], derivative)
        for a in range(3):
            for b in range(3):
                hessian[at + a, at + b] += 0.5 * (derivative[a, b] + derivative[b, a])
        lift = design.weight[strand, edge + 1] * _length(x, edge)
        if not _is_definite(hessian, at, MARGIN * lift):
            return edge
        if edge > 0:
            for a in range(3):
                for b in range(3):
                    hessian[before + a, before + b] += 0.5 * (derivative[a, b] + derivative[b, a])
                    hessian[at + a, before + b] -= derivative[b, a]
            _eliminate(hessian, edge)
    return -1


@njit(cache=True)
def _fill_normals(directions: np.ndarray, normals: np.ndarray) -> None:
    """Normals of the frame before each edge, transported from some normal at the root."""
    first = _row(directions, 0)
    axis = (1.0, 0.0, 0.0) if abs(first[0]) < 0.7 else (0.0, 1.0, 0.0)
    across = cross(first, axis)
    size = np.sqrt(dot(across, across))
    normal, before = (across[0] / size, across[1] / size, across[2] / size), first
    for edge in range(len(directions)):
        normals[edge, 0], normals[edge, 1], normals[edge, 2] = normal
        direction = _row(directions, edge)
        normal = transported(normal, before, direction)
        before = direction
