"""A clamped heavy rod as a boundary-value problem: what the full Cosserat rod must converge to.

Kirchhoff's rod: inextensible, unshearable, with linear bending and twisting (Antman, "Nonlinear Problems of
Elasticity"). With s the length from the clamp, weight w per length and material frame R = (d1 d2 d3):

    r' = d3,   R' = R [kappa]x,   kappa = rest_curvature + B^-1 R^T m,   m' = -d3 x n,   n = (0, 0, -w (L - s))

r and R are given at the clamp, the moment m vanishes at the tip. Solved in units of L and EI / L.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_bvp
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

from quaffure.types import Float

Array = np.ndarray
REAL_HAIR_WEIGHT = 6.4e-5
"""Weight of a hair per length [N/m]."""


LOADS = np.geomspace(1e-2, 1, 12)
"""Shares of the weight under which the rod is solved one after the other."""
TOLERANCE = 1e-7
"""Largest relative residual of the equations."""
HORIZONTAL = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
"""Material frame, d1, d2, d3 in columns, of a tangent along x."""


@dataclass(frozen=True)
class HeavyRod:
    """A rod at rest with constant curvature and twist: straight, a circle or a helix.

    Attributes:
        length: [m].
        bend, twist: EI and GJ [N m^2].
        weight: per length [N/m], along -z.
        clamp: columns are d1, d2 and the tangent d3 at the root.
        rest_curvature: of the unstrained rod about d1, d2, d3 [1/m]; a helix has (0, curvature, torsion).
    """

    length: float
    bend: float = 8.0e-9
    twist: float = 8.0e-9 / 1.35
    weight: float = REAL_HAIR_WEIGHT
    clamp: tuple[tuple[float, ...], ...] = HORIZONTAL
    rest_curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def shape(self, arc_length: Float[Array, " n"]) -> Float[Array, "n 3"]:
        """Positions [m] at distances from the clamp [m], the clamp at the origin.

        The load is raised step by step, so of several equilibria this is the one that grows out of the unloaded rod.

        Raises:
            ArithmeticError: the boundary-value solver did not reach its tolerance.
        """
        return self.length * _solution(self)(np.asarray(arc_length) / self.length)[:3].T


@lru_cache(maxsize=64)
def _solution(rod: HeavyRod) -> PPoly:
    mesh = np.linspace(0, 1, 101)
    state = _unloaded(rod, mesh)
    for load in LOADS:
        solution = solve_bvp(
            lambda s, y, load=load: _slopes(rod, load, s, y),
            lambda at_clamp, at_tip: _boundary(rod, at_clamp, at_tip),
            mesh,
            state,
            tol=TOLERANCE if load == 1 else 1e-3,
            max_nodes=20000,
        )
        if solution.status:
            raise ArithmeticError(f"heavy rod at {load:.3f} of its weight: {solution.message}")
        mesh, state = solution.x, solution.y
    return solution.sol


def _slopes(rod: HeavyRod, load: float, s: Array, y: Array) -> Array:
    """Derivatives along the rod of position, quaternion wxyz and moment (world axes), in units of L and EI / L."""
    quaternion, moment = y[3:7], y[7:]
    d1, d2, d3 = _frame(quaternion)
    compliance = np.array([1.0, 1.0, rod.bend / rod.twist])
    local_moment = np.stack([(axis * moment).sum(0) for axis in (d1, d2, d3)])
    curvature = rod.length * np.array(rod.rest_curvature)[:, None] + compliance[:, None] * local_moment
    hanging = load * rod.weight * rod.length**3 / rod.bend * (1 - s)
    force = np.stack([0 * s, 0 * s, -hanging])
    return np.concatenate([d3, _turned(quaternion, curvature), -np.cross(d3, force, axis=0)])


def _turned(quaternion: Array, curvature: Array) -> Array:
    """q (0, kappa) / 2: the derivative of the quaternion."""
    w, v = quaternion[:1], quaternion[1:]
    scalar = -(v * curvature).sum(0, keepdims=True)
    return 0.5 * np.concatenate([scalar, w * curvature + np.cross(v, curvature, axis=0)])


def _boundary(rod: HeavyRod, at_clamp: Array, at_tip: Array) -> Array:
    return np.concatenate([at_clamp[:3], at_clamp[3:7] - _quaternion(np.array(rod.clamp)), at_tip[7:]])


def _unloaded(rod: HeavyRod, mesh: Array) -> Array:
    """The rest shape: a turn at constant speed about the Darboux vector; positions by the trapezoidal rule."""
    turn = rod.length * np.array(rod.rest_curvature)
    speed = np.linalg.norm(turn)
    axis = turn / speed if speed > 0 else turn
    half = 0.5 * speed * mesh
    first = _quaternion(np.array(rod.clamp))
    w, v = np.cos(half), axis[:, None] * np.sin(half)
    quaternion = np.concatenate(
        [[first[0] * w - first[1:] @ v], first[0] * v + w * first[1:, None] + np.cross(first[1:, None], v, axis=0)]
    )
    d3 = _frame(quaternion)[2]
    steps = 0.5 * (d3[:, 1:] + d3[:, :-1]) * np.diff(mesh)
    position = np.concatenate([np.zeros((3, 1)), steps.cumsum(1)], axis=1)
    return np.concatenate([position, quaternion, np.zeros_like(position)])


def _frame(quaternion: Array) -> tuple[Array, Array, Array]:
    """d1, d2, d3 of unit quaternions `wxyz` [4 n]."""
    w, x, y, z = quaternion
    return (
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]),
        np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]),
        np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]),
    )


def _quaternion(matrix: Array) -> Array:
    """Unit quaternion `wxyz` of one rotation matrix, by scipy's independent route."""
    x, y, z, w = Rotation.from_matrix(matrix).as_quat()
    return np.array([w, x, y, z])
