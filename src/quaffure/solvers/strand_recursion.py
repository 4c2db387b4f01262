"""Newton's step of single strands by elimination from tip to root, eight strands abreast.

The unknowns are rotations theta_i of the edges, from which the displacements of the vertices follow,
u_(i+1) = u_i + l_i theta_i x t_i, so that lengths stay. What lies beyond an edge enters as a quadratic function of
(u_i, theta_(i-1)) alone; eliminating theta_i from it costs a few products of 3 x 3 matrices, and no matrix of a whole
strand is ever formed. Per edge the model of the energy is

    (theta_i - theta_(i-1))^T D_i (theta_i - theta_(i-1)) / 2 + (max(F_i . t_i, 0) l_i + w_i) |theta_i x t_i|^2 / 2

and per vertex G . u + u^T (c n n^T + h I) u / 2: D_i is the Gauss-Newton matrix of the joint, F_i the force on all
beyond the edge (tension stiffens), w_i the weight of its goal, G the gradient of the whole energy, c and n stiffness
and normal of the contact and h a stiffness in all directions. Twist is theta's part along the edge; eliminated with the
rest, it is quasi-static.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.energies.body_collision import contact_stiffness
from quaffure.energies.rod_kernels import Vector, cross, dot
from quaffure.geometry.symmetric_matrix import Symmetric, symmetric_inverse, symmetric_times

LANES = 8
"""Strands in a block: one 512-bit register of float64. In float32 the stiffness of deep contact would leave nothing of
the bending stiffness, which is a thousand times less."""
LEAST_STIFFNESS = 1e-4
"""Stiffness added to every rotation, relative to the bending stiffness: keeps the system positive definite."""
LEAST_ALIGNMENT = 0.02
"""1 + cos of the angle between two edges, at least: below, the model of their twist is worth nothing."""
Rows = tuple[Vector, Vector, Vector]
_TINY = 1e-30


class StrandModel(NamedTuple):
    """The quadratic model of every strand's energy.

    Attributes:
        direction: t, unit direction of every edge [strand edge 3].
        root_direction: tangent of the frame at the root [strand 3].
        length: l of every edge [m], [strand edge].
        bending, twisting: B and C of every joint [J], [strand edge].
        goal: stiffness of what holds an edge's direction [J], [strand edge].
        gradient: of the strand's own energy by the vertices [N], [strand vertex 3]; G is the sum with that of its
            surroundings.
        contact: unit normal n, and how far within its margin every vertex is [m], [strand vertex 4].
        around_gradient: of its surroundings' energy by the vertices [N], [strand vertex 3].
        around_stiffness: h of every vertex [N/m], [strand vertex].
    """

    direction: np.ndarray
    root_direction: np.ndarray
    length: np.ndarray
    bending: np.ndarray
    twisting: np.ndarray
    goal: np.ndarray
    gradient: np.ndarray
    contact: np.ndarray
    around_gradient: np.ndarray
    around_stiffness: np.ndarray


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def newton_rotations(
    model: StrandModel, k_body_collision: float | np.floating, strands: np.ndarray, rotation: np.ndarray
) -> None:
    """Fill the rotation theta [rad] of every edge that minimizes the model, for the `strands` listed.

    Args:
        k_body_collision: k_bc of Eq. 10 [J/m^3], whose second derivative is c.
        rotation: [strand edge 3].
    """
    blocks = (len(strands) + LANES - 1) // LANES
    for block in prange(blocks):
        _solve_block(model, k_body_collision, strands[block * LANES : (block + 1) * LANES], rotation)


# Rows of the input of an edge, of what its elimination leaves for the way back, and of the quadratic function.
_T, _B, _C, _L, _GOAL, _G, _N, _CONTACT, _H, _INPUTS = 0, 3, 4, 5, 6, 7, 10, 13, 14, 15
_KU, _KP, _K, _LEFT = 0, 9, 18, 21
_UU, _UP, _PP, _U, _P, _STATE = 0, 6, 15, 21, 24, 27


@njit(cache=True, fastmath=True, error_model="numpy")
def _solve_block(
    model: StrandModel, k_body_collision: float | np.floating, strands: np.ndarray, rotation: np.ndarray
) -> None:
    edges = model.direction.shape[1]
    inputs = np.zeros((edges + 1, _INPUTS, LANES), np.float64)
    left = np.empty((edges, _LEFT, LANES), np.float64)
    state = np.zeros((_STATE, LANES), np.float64)
    force = np.zeros((3, LANES), np.float64)
    for lane in range(LANES):
        _gather(model, k_body_collision, strands[min(lane, len(strands) - 1)], lane, inputs)
    for edge in range(edges - 1, -1, -1):
        _eliminate(inputs[edge + 1], inputs[edge], state, force, left[edge])
    _substitute(inputs, left, strands, rotation)


@njit(cache=True, fastmath=True, error_model="numpy")
def _gather(
    model: StrandModel, k_body_collision: float | np.floating, strand: int, lane: int, inputs: np.ndarray
) -> None:
    """Row 0 holds the tangent at the root, row i + 1 edge i and the vertex at its end."""
    for axis in range(3):
        inputs[0, _T + axis, lane] = model.root_direction[strand, axis]
    for edge in range(model.direction.shape[1]):
        row = inputs[edge + 1]
        for axis in range(3):
            row[_T + axis, lane] = model.direction[strand, edge, axis]
            own, other = model.gradient[strand, edge + 1, axis], model.around_gradient[strand, edge + 1, axis]
            row[_G + axis, lane] = own + other
            row[_N + axis, lane] = model.contact[strand, edge + 1, axis]
        row[_B, lane], row[_C, lane] = model.bending[strand, edge], model.twisting[strand, edge]
        row[_L, lane], row[_GOAL, lane] = model.length[strand, edge], model.goal[strand, edge]
        row[_CONTACT, lane] = contact_stiffness(model.contact[strand, edge + 1, 3], k_body_collision)
        row[_H, lane] = model.around_stiffness[strand, edge + 1]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _load(array: np.ndarray, row: int, lane: int) -> Vector:
    return array[row, lane], array[row + 1, lane], array[row + 2, lane]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _store(array: np.ndarray, row: int, lane: int, v: Vector) -> None:
    array[row, lane], array[row + 1, lane], array[row + 2, lane] = v[0], v[1], v[2]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _load_symmetric(array: np.ndarray, row: int, lane: int) -> Symmetric:
    return (
        array[row, lane], array[row + 1, lane], array[row + 2, lane],
        array[row + 3, lane], array[row + 4, lane], array[row + 5, lane],
    )  # fmt: skip


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _store_symmetric(array: np.ndarray, row: int, lane: int, m: Symmetric) -> None:
    array[row, lane], array[row + 1, lane], array[row + 2, lane] = m[0], m[1], m[2]
    array[row + 3, lane], array[row + 4, lane], array[row + 5, lane] = m[3], m[4], m[5]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _joint_matrix(before: Vector, t: Vector, bend: float, twist: float) -> Symmetric:
    """D = B S^T S + C w w^T, S d = d x t - (t_before x t) (w . d) / 2, w . d the twist between the two edges."""
    inverse = 1.0 / max(1.0 + dot(t, before), LEAST_ALIGNMENT)
    w = ((t[0] + before[0]) * inverse, (t[1] + before[1]) * inverse, (t[2] + before[2]) * inverse)
    k = cross(before, t)
    q = cross(t, k)
    across = twist + bend * 0.25 * dot(k, k)
    half = 0.5 * bend
    return (
        bend * (1.0 - t[0] * t[0]) - half * (q[0] * w[0] + w[0] * q[0]) + across * w[0] * w[0],
        -bend * t[1] * t[0] - half * (q[1] * w[0] + w[1] * q[0]) + across * w[1] * w[0],
        bend * (1.0 - t[1] * t[1]) - half * (q[1] * w[1] + w[1] * q[1]) + across * w[1] * w[1],
        -bend * t[2] * t[0] - half * (q[2] * w[0] + w[2] * q[0]) + across * w[2] * w[0],
        -bend * t[2] * t[1] - half * (q[2] * w[1] + w[2] * q[1]) + across * w[2] * w[1],
        bend * (1.0 - t[2] * t[2]) - half * (q[2] * w[2] + w[2] * q[2]) + across * w[2] * w[2],
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _vertex_matrix(state: Symmetric, n: Vector, c: float, h: float) -> Symmetric:
    """What is known of u_(i+1) with the contact and the surroundings of its vertex."""
    return (
        state[0] + h + c * n[0] * n[0],
        state[1] + c * n[1] * n[0],
        state[2] + h + c * n[1] * n[1],
        state[3] + c * n[2] * n[0],
        state[4] + c * n[2] * n[1],
        state[5] + h + c * n[2] * n[2],
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _edge_matrix(d: Symmetric, pp: Symmetric, p: Rows, a: Rows, arm: Vector) -> Symmetric:
    """A_tt but for tension: D + P_pp + J^T A_ut + (J^T P_up)^T, where J^T v = (l t) x v."""
    a0 = cross(arm, (a[0][0], a[1][0], a[2][0]))
    a1 = cross(arm, (a[0][1], a[1][1], a[2][1]))
    a2 = cross(arm, (a[0][2], a[1][2], a[2][2]))
    p0 = cross(arm, (p[0][0], p[1][0], p[2][0]))
    p1 = cross(arm, (p[0][1], p[1][1], p[2][1]))
    p2 = cross(arm, (p[0][2], p[1][2], p[2][2]))
    return (
        d[0] + pp[0] + a0[0] + p0[0],
        d[1] + pp[1] + a0[1] + p1[0],
        d[2] + pp[2] + a1[1] + p1[1],
        d[3] + pp[3] + a0[2] + p2[0],
        d[4] + pp[4] + a1[2] + p2[1],
        d[5] + pp[5] + a2[2] + p2[2],
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _stiffened(m: Symmetric, t: Vector, tension: float, least: float) -> Symmetric:
    """A_tt with tension (I - t t^T), and a little of I."""
    return (
        m[0] + tension * (1.0 - t[0] * t[0]) + least,
        m[1] - tension * t[1] * t[0],
        m[2] + tension * (1.0 - t[1] * t[1]) + least,
        m[3] - tension * t[2] * t[0],
        m[4] - tension * t[2] * t[1],
        m[5] + tension * (1.0 - t[2] * t[2]) + least,
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _reduced(m: Symmetric, rows: Rows, columns: Rows) -> Symmetric:
    """A symmetric matrix less the symmetric product of `rows` and `columns`, each a tuple of vectors."""
    return (
        m[0] - dot(rows[0], columns[0]),
        m[1] - dot(rows[1], columns[0]),
        m[2] - dot(rows[1], columns[1]),
        m[3] - dot(rows[2], columns[0]),
        m[4] - dot(rows[2], columns[1]),
        m[5] - dot(rows[2], columns[2]),
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def _eliminate(row: np.ndarray, before: np.ndarray, state: np.ndarray, force: np.ndarray, left: np.ndarray) -> None:
    """Take vertex i + 1 and edge i into the quadratic function in `state`, and eliminate the edge's rotation."""
    for lane in range(LANES):
        t, g = _load(row, _T, lane), _load(row, _G, lane)
        bend, length = row[_B, lane], row[_L, lane]
        arm = (length * t[0], length * t[1], length * t[2])
        f = _load(force, 0, lane)
        f = (f[0] - g[0], f[1] - g[1], f[2] - g[2])
        _store(force, 0, lane, f)
        m = _vertex_matrix(_load_symmetric(state, _UU, lane), _load(row, _N, lane), row[_CONTACT, lane], row[_H, lane])
        p = (_load(state, _UP, lane), _load(state, _UP + 3, lane), _load(state, _UP + 6, lane))
        mu = _load(state, _U, lane)
        mu = (mu[0] + g[0], mu[1] + g[1], mu[2] + g[2])
        d = _joint_matrix(_load(before, _T, lane), t, bend, row[_C, lane])
        # A_ut = M J + P_up with J = -l [t]x: a row of M J is l t x that row of M.
        x, y, z = cross(arm, (m[0], m[1], m[3])), cross(arm, (m[1], m[2], m[4])), cross(arm, (m[3], m[4], m[5]))
        a = (
            (p[0][0] + x[0], p[0][1] + x[1], p[0][2] + x[2]),
            (p[1][0] + y[0], p[1][1] + y[1], p[1][2] + y[2]),
            (p[2][0] + z[0], p[2][1] + z[1], p[2][2] + z[2]),
        )
        tension = max(dot(f, arm), 0.0) + row[_GOAL, lane]
        least = LEAST_STIFFNESS * bend + _TINY
        s = _edge_matrix(d, _load_symmetric(state, _PP, lane), p, a, arm)
        inverse = symmetric_inverse(_stiffened(s, t, tension, least), least)
        turned, own = cross(arm, mu), _load(state, _P, lane)
        k = symmetric_times(inverse, (turned[0] + own[0], turned[1] + own[1], turned[2] + own[2]))
        # Columns of K_u = A_tt^-1 A_ut^T and K_p = A_tt^-1 D.
        u = (symmetric_times(inverse, a[0]), symmetric_times(inverse, a[1]), symmetric_times(inverse, a[2]))
        rows = ((d[0], d[1], d[3]), (d[1], d[2], d[4]), (d[3], d[4], d[5]))
        o = (symmetric_times(inverse, rows[0]), symmetric_times(inverse, rows[1]), symmetric_times(inverse, rows[2]))
        for axis in range(3):
            _store(left, _KU + 3 * axis, lane, (u[0][axis], u[1][axis], u[2][axis]))
            _store(left, _KP + 3 * axis, lane, (o[0][axis], o[1][axis], o[2][axis]))
            _store(state, _UP + 3 * axis, lane, (dot(a[axis], o[0]), dot(a[axis], o[1]), dot(a[axis], o[2])))
        _store(left, _K, lane, k)
        _store_symmetric(state, _UU, lane, _reduced(m, a, u))
        _store_symmetric(state, _PP, lane, _reduced(d, rows, o))
        _store(state, _U, lane, (mu[0] - dot(a[0], k), mu[1] - dot(a[1], k), mu[2] - dot(a[2], k)))
        _store(state, _P, lane, (dot(rows[0], k), dot(rows[1], k), dot(rows[2], k)))


@njit(cache=True, fastmath=True, error_model="numpy")
def _substitute(inputs: np.ndarray, left: np.ndarray, strands: np.ndarray, rotation: np.ndarray) -> None:
    """From root to tip: theta_i = K_p theta_(i-1) - K_u u_i - k, and u_(i+1)."""
    edges = len(left)
    path = np.zeros((6, LANES), np.float64)
    found = np.empty((edges, 3, LANES), np.float64)
    for edge in range(edges):
        row, coefficients, out = inputs[edge + 1], left[edge], found[edge]
        for lane in range(LANES):
            u, before, k = _load(path, 0, lane), _load(path, 3, lane), _load(coefficients, _K, lane)
            theta = (
                dot(_load(coefficients, _KP, lane), before) - dot(_load(coefficients, _KU, lane), u) - k[0],
                dot(_load(coefficients, _KP + 3, lane), before) - dot(_load(coefficients, _KU + 3, lane), u) - k[1],
                dot(_load(coefficients, _KP + 6, lane), before) - dot(_load(coefficients, _KU + 6, lane), u) - k[2],
            )
            moved, length = cross(theta, _load(row, _T, lane)), row[_L, lane]
            _store(path, 0, lane, (u[0] + length * moved[0], u[1] + length * moved[1], u[2] + length * moved[2]))
            _store(path, 3, lane, theta)
            _store(out, 0, lane, theta)
    for lane in range(len(strands)):
        for edge in range(edges):
            for axis in range(3):
                rotation[strands[lane], edge, axis] = found[edge, axis, lane]
