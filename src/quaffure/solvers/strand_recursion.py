"""Newton's step of single strands by elimination from tip to root, eight strands abreast.

The unknowns are rotations theta_i of the edges, from which the displacements of the vertices follow,
u_(i+1) = u_i + l_i theta_i x t_i, so that lengths stay. What lies beyond an edge enters as a quadratic function of
(u_i, theta_(i-1)) alone; eliminating theta_i from it costs a few products of 3 x 3 matrices, and no matrix of a whole
strand is ever formed. Per edge the model of the energy is

    (theta_i - theta_(i-1))^T D_i (theta_i - theta_(i-1)) / 2 + max(F_i . t_i, 0) l_i |theta_i x t_i|^2 / 2

and per vertex G . u + u^T (c n n^T + h I) u / 2: D_i is the Gauss-Newton matrix of the joint, F_i the force on all
beyond the edge (tension stiffens), G the gradient of the whole energy, c and n stiffness and normal of the contact and
h a stiffness in all directions. Twist is theta's part along the edge; eliminated with the rest, it is quasi-static.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.energies.body_collision import contact_stiffness

LANES = 8
"""Strands in a block: one 512-bit register of float64. In float32 the stiffness of deep contact would leave nothing of
the bending stiffness, which is a thousand times less."""
LEAST_STIFFNESS = 1e-4
"""Stiffness added to every rotation, relative to the bending stiffness: keeps the system positive definite."""
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
def newton_rotations(model: StrandModel, k_body_collision: float, strands: np.ndarray, rotation: np.ndarray) -> None:
    """Fill the rotation theta [rad] of every edge that minimizes the model, for the `strands` listed.

    Args:
        k_body_collision: k_bc of Eq. 10 [J/m^3], whose second derivative is c.
        rotation: [strand edge 3].
    """
    blocks = (len(strands) + LANES - 1) // LANES
    for block in prange(blocks):
        _solve_block(model, k_body_collision, strands[block * LANES : (block + 1) * LANES], rotation)


# Rows of the gathered input of an edge, and of what the elimination leaves for the way back.
_T, _B, _C, _L, _GOAL, _G, _N, _CONTACT, _H = 0, 3, 4, 5, 6, 7, 10, 13, 14
_INPUTS = 15
_KU, _KP, _K = 0, 9, 18
_LEFT = 21
_STATE = 27  # P_uu 6, P_up 9, P_pp 6, p_u 3, p_p 3


@njit(cache=True, fastmath=True, error_model="numpy")
def _solve_block(model: StrandModel, k_body_collision: float, strands: np.ndarray, rotation: np.ndarray) -> None:
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
def _gather(model: StrandModel, k_body_collision: float, strand: int, lane: int, inputs: np.ndarray) -> None:
    """Row 0 holds the tangent at the root, row i + 1 edge i and the vertex at its end."""
    for axis in range(3):
        inputs[0, _T + axis, lane] = model.root_direction[strand, axis]
    for edge in range(model.direction.shape[1]):
        row = inputs[edge + 1]
        for axis in range(3):
            row[_T + axis, lane] = model.direction[strand, edge, axis]
            row[_G + axis, lane] = (
                model.gradient[strand, edge + 1, axis] + model.around_gradient[strand, edge + 1, axis]
            )
            row[_N + axis, lane] = model.contact[strand, edge + 1, axis]
        row[_B, lane], row[_C, lane] = model.bending[strand, edge], model.twisting[strand, edge]
        row[_L, lane], row[_GOAL, lane] = model.length[strand, edge], model.goal[strand, edge]
        row[_CONTACT, lane] = contact_stiffness(model.contact[strand, edge + 1, 3], k_body_collision)
        row[_H, lane] = model.around_stiffness[strand, edge + 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def _eliminate(row: np.ndarray, before: np.ndarray, state: np.ndarray, force: np.ndarray, left: np.ndarray) -> None:
    """Take vertex i + 1 and edge i into the quadratic function in `state`, and eliminate the edge's rotation.

    Longer than other functions: cut up, the compiler would not keep its hundred numbers in registers.
    """
    for lane in range(LANES):
        tx, ty, tz = row[_T, lane], row[_T + 1, lane], row[_T + 2, lane]
        bx, by, bz = before[_T, lane], before[_T + 1, lane], before[_T + 2, lane]
        bend, twist, length, goal = row[_B, lane], row[_C, lane], row[_L, lane], row[_GOAL, lane]
        gx, gy, gz = row[_G, lane], row[_G + 1, lane], row[_G + 2, lane]
        nx, ny, nz = row[_N, lane], row[_N + 1, lane], row[_N + 2, lane]
        c, h = row[_CONTACT, lane], row[_H, lane]
        # M: what is known of u_(i+1).
        m00 = state[0, lane] + h + c * nx * nx
        m10 = state[1, lane] + c * ny * nx
        m11 = state[2, lane] + h + c * ny * ny
        m20 = state[3, lane] + c * nz * nx
        m21 = state[4, lane] + c * nz * ny
        m22 = state[5, lane] + h + c * nz * nz
        p00, p01, p02 = state[6, lane], state[7, lane], state[8, lane]
        p10, p11, p12 = state[9, lane], state[10, lane], state[11, lane]
        p20, p21, p22 = state[12, lane], state[13, lane], state[14, lane]
        mx, my, mz = state[21, lane] + gx, state[22, lane] + gy, state[23, lane] + gz
        fx, fy, fz = force[0, lane] - gx, force[1, lane] - gy, force[2, lane] - gz
        force[0, lane], force[1, lane], force[2, lane] = fx, fy, fz
        # D = B S^T S + C w w^T, S d = d x t - (t_before x t) (w . d) / 2, w . d the twist between the two edges.
        inverse = 1.0 / max(1.0 + tx * bx + ty * by + tz * bz, 0.02)
        wx, wy, wz = (tx + bx) * inverse, (ty + by) * inverse, (tz + bz) * inverse
        kx, ky, kz = by * tz - bz * ty, bz * tx - bx * tz, bx * ty - by * tx
        qx, qy, qz = 0.5 * (ty * kz - tz * ky), 0.5 * (tz * kx - tx * kz), 0.5 * (tx * ky - ty * kx)
        across = twist + bend * 0.25 * (kx * kx + ky * ky + kz * kz)
        d00 = bend * (1.0 - tx * tx - qx * wx - wx * qx) + across * wx * wx
        d10 = bend * (-ty * tx - qy * wx - wy * qx) + across * wy * wx
        d11 = bend * (1.0 - ty * ty - qy * wy - wy * qy) + across * wy * wy
        d20 = bend * (-tz * tx - qz * wx - wz * qx) + across * wz * wx
        d21 = bend * (-tz * ty - qz * wy - wz * qy) + across * wz * wy
        d22 = bend * (1.0 - tz * tz - qz * wz - wz * qz) + across * wz * wz
        # A_ut = M J + P_up with J = -l [t]x: a row of M J is l t x that row of M.
        lx, ly, lz = length * tx, length * ty, length * tz
        a00, a01, a02 = p00 + ly * m20 - lz * m10, p01 + lz * m00 - lx * m20, p02 + lx * m10 - ly * m00
        a10, a11, a12 = p10 + ly * m21 - lz * m11, p11 + lz * m10 - lx * m21, p12 + lx * m11 - ly * m10
        a20, a21, a22 = p20 + ly * m22 - lz * m21, p21 + lz * m20 - lx * m22, p22 + lx * m21 - ly * m20
        # A_tt = J^T A_ut + (J^T P_up)^T + P_pp + D + geometric + goal; J^T v = l t x v.
        j00 = ly * a20 - lz * a10
        j10, j11 = lz * a00 - lx * a20, lz * a01 - lx * a21
        j20, j21, j22 = lx * a10 - ly * a00, lx * a11 - ly * a01, lx * a12 - ly * a02
        k00, k01, k02 = ly * p20 - lz * p10, ly * p21 - lz * p11, ly * p22 - lz * p12
        k11, k12 = lz * p01 - lx * p21, lz * p02 - lx * p22
        k22 = lx * p12 - ly * p02
        tension = max(fx * lx + fy * ly + fz * lz, 0.0) + goal
        least = LEAST_STIFFNESS * bend
        s00 = j00 + k00 + state[15, lane] + d00 + tension * (1.0 - tx * tx) + least
        s10 = j10 + k01 + state[16, lane] + d10 - tension * ty * tx
        s11 = j11 + k11 + state[17, lane] + d11 + tension * (1.0 - ty * ty) + least
        s20 = j20 + k02 + state[18, lane] + d20 - tension * tz * tx
        s21 = j21 + k12 + state[19, lane] + d21 - tension * tz * ty
        s22 = j22 + k22 + state[20, lane] + d22 + tension * (1.0 - tz * tz) + least
        rx = ly * mz - lz * my + state[24, lane]
        ry = lz * mx - lx * mz + state[25, lane]
        rz = lx * my - ly * mx + state[26, lane]
        # Inverse of A_tt by L D L^T; rounding must not make a pivot negative.
        i0 = 1.0 / max(s00, least + _TINY)
        l10, l20 = s10 * i0, s20 * i0
        i1 = 1.0 / max(s11 - l10 * s10, least + _TINY)
        e21 = s21 - l20 * s10
        l21 = e21 * i1
        i2 = 1.0 / max(s22 - l20 * s20 - l21 * e21, least + _TINY)
        n20 = l10 * l21 - l20
        v22 = i2
        v21 = -l21 * i2
        v20 = n20 * i2
        v11 = i1 + l21 * l21 * i2
        v10 = -l10 * i1 - l21 * n20 * i2
        v00 = i0 + l10 * l10 * i1 + n20 * n20 * i2
        # K_u = A_tt^-1 A_ut^T, K_p = A_tt^-1 D, k = A_tt^-1 b.
        u00, u01, u02 = (
            v00 * a00 + v10 * a01 + v20 * a02,
            v00 * a10 + v10 * a11 + v20 * a12,
            v00 * a20 + v10 * a21 + v20 * a22,
        )
        u10, u11, u12 = (
            v10 * a00 + v11 * a01 + v21 * a02,
            v10 * a10 + v11 * a11 + v21 * a12,
            v10 * a20 + v11 * a21 + v21 * a22,
        )
        u20, u21, u22 = (
            v20 * a00 + v21 * a01 + v22 * a02,
            v20 * a10 + v21 * a11 + v22 * a12,
            v20 * a20 + v21 * a21 + v22 * a22,
        )
        o00, o01, o02 = (
            v00 * d00 + v10 * d10 + v20 * d20,
            v00 * d10 + v10 * d11 + v20 * d21,
            v00 * d20 + v10 * d21 + v20 * d22,
        )
        o10, o11, o12 = (
            v10 * d00 + v11 * d10 + v21 * d20,
            v10 * d10 + v11 * d11 + v21 * d21,
            v10 * d20 + v11 * d21 + v21 * d22,
        )
        o20, o21, o22 = (
            v20 * d00 + v21 * d10 + v22 * d20,
            v20 * d10 + v21 * d11 + v22 * d21,
            v20 * d20 + v21 * d21 + v22 * d22,
        )
        kx, ky, kz = v00 * rx + v10 * ry + v20 * rz, v10 * rx + v11 * ry + v21 * rz, v20 * rx + v21 * ry + v22 * rz
        left[0, lane], left[1, lane], left[2, lane] = u00, u01, u02
        left[3, lane], left[4, lane], left[5, lane] = u10, u11, u12
        left[6, lane], left[7, lane], left[8, lane] = u20, u21, u22
        left[9, lane], left[10, lane], left[11, lane] = o00, o01, o02
        left[12, lane], left[13, lane], left[14, lane] = o10, o11, o12
        left[15, lane], left[16, lane], left[17, lane] = o20, o21, o22
        left[18, lane], left[19, lane], left[20, lane] = kx, ky, kz
        # What is left for (u_i, theta_(i-1)).
        state[0, lane] = m00 - (a00 * u00 + a01 * u10 + a02 * u20)
        state[1, lane] = m10 - (a10 * u00 + a11 * u10 + a12 * u20)
        state[2, lane] = m11 - (a10 * u01 + a11 * u11 + a12 * u21)
        state[3, lane] = m20 - (a20 * u00 + a21 * u10 + a22 * u20)
        state[4, lane] = m21 - (a20 * u01 + a21 * u11 + a22 * u21)
        state[5, lane] = m22 - (a20 * u02 + a21 * u12 + a22 * u22)
        state[6, lane] = a00 * o00 + a01 * o10 + a02 * o20
        state[7, lane] = a00 * o01 + a01 * o11 + a02 * o21
        state[8, lane] = a00 * o02 + a01 * o12 + a02 * o22
        state[9, lane] = a10 * o00 + a11 * o10 + a12 * o20
        state[10, lane] = a10 * o01 + a11 * o11 + a12 * o21
        state[11, lane] = a10 * o02 + a11 * o12 + a12 * o22
        state[12, lane] = a20 * o00 + a21 * o10 + a22 * o20
        state[13, lane] = a20 * o01 + a21 * o11 + a22 * o21
        state[14, lane] = a20 * o02 + a21 * o12 + a22 * o22
        state[15, lane] = d00 - (d00 * o00 + d10 * o10 + d20 * o20)
        state[16, lane] = d10 - (d10 * o00 + d11 * o10 + d21 * o20)
        state[17, lane] = d11 - (d10 * o01 + d11 * o11 + d21 * o21)
        state[18, lane] = d20 - (d20 * o00 + d21 * o10 + d22 * o20)
        state[19, lane] = d21 - (d20 * o01 + d21 * o11 + d22 * o21)
        state[20, lane] = d22 - (d20 * o02 + d21 * o12 + d22 * o22)
        state[21, lane] = mx - (a00 * kx + a01 * ky + a02 * kz)
        state[22, lane] = my - (a10 * kx + a11 * ky + a12 * kz)
        state[23, lane] = mz - (a20 * kx + a21 * ky + a22 * kz)
        state[24, lane] = d00 * kx + d10 * ky + d20 * kz
        state[25, lane] = d10 * kx + d11 * ky + d21 * kz
        state[26, lane] = d20 * kx + d21 * ky + d22 * kz


@njit(cache=True, fastmath=True, error_model="numpy")
def _substitute(inputs: np.ndarray, left: np.ndarray, strands: np.ndarray, rotation: np.ndarray) -> None:
    """From root to tip: theta_i = K_p theta_(i-1) - K_u u_i - k, and u_(i+1)."""
    edges = len(left)
    path = np.zeros((6, LANES), np.float64)
    found = np.empty((edges, 3, LANES), np.float64)
    for edge in range(edges):
        row, k, out = inputs[edge + 1], left[edge], found[edge]
        for lane in range(LANES):
            ux, uy, uz = path[0, lane], path[1, lane], path[2, lane]
            px, py, pz = path[3, lane], path[4, lane], path[5, lane]
            ax = (
                k[9, lane] * px
                + k[10, lane] * py
                + k[11, lane] * pz
                - k[18, lane]
                - k[0, lane] * ux
                - k[1, lane] * uy
                - k[2, lane] * uz
            )
            ay = (
                k[12, lane] * px
                + k[13, lane] * py
                + k[14, lane] * pz
                - k[19, lane]
                - k[3, lane] * ux
                - k[4, lane] * uy
                - k[5, lane] * uz
            )
            az = (
                k[15, lane] * px
                + k[16, lane] * py
                + k[17, lane] * pz
                - k[20, lane]
                - k[6, lane] * ux
                - k[7, lane] * uy
                - k[8, lane] * uz
            )
            tx, ty, tz, length = row[_T, lane], row[_T + 1, lane], row[_T + 2, lane], row[_L, lane]
            path[0, lane] = ux + length * (ay * tz - az * ty)
            path[1, lane] = uy + length * (az * tx - ax * tz)
            path[2, lane] = uz + length * (ax * ty - ay * tx)
            path[3, lane], path[4, lane], path[5, lane] = ax, ay, az
            out[0, lane], out[1, lane], out[2, lane] = ax, ay, az
    for lane in range(len(strands)):
        for edge in range(edges):
            for axis in range(3):
                rotation[strands[lane], edge, axis] = found[edge, axis, lane]
