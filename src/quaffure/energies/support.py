"""Forces by which the body supports a groom's design: those that leave the least elastic energy in the strands.

    min over 0 <= s <= s_max of  sum_i |m_i|^2 / B_i + T_i^2 / C_i  +  sum_j c_j s_j^2

with m_i and T_i the bending and twist moments of `quaffure.energies.sag_free`, linear in the support forces s_j n_j at
the vertices. What the body carries in this sense is more than weight: a strand bent over the crown presses on it by its
tension times its curvature. Least squares within bounds, of at most 23 unknowns a strand, by coordinate descent.
Without an upper bound, a vertex beside a kink or a tie would push with thousands of weights on a lever of no length.
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit, prange

from quaffure.energies.rod import LEAST_ALIGNMENT
from quaffure.energies.rod_kernels import Vector, cross, dot
from quaffure.geometry.polyline import directors
from quaffure.types import Bool, Float, Tensor

SWEEPS = 60
MOST_SUPPORT = 2.0
"""Largest force on a vertex, in weights of the strand from there to its tip: what a rope over a pulley presses with."""
REGULARIZATION = 1e-3
"""c of a vertex that is near the skin, relative to the mean diagonal of the least-squares problem."""
DISTANT = 100.0
"""How many times larger c is, at a vertex available by a half."""


@dataclass(frozen=True, eq=False)
class StrandForces:
    """Strands of the design with what pulls and resists, in float64.

    Attributes:
        strands: vertices [m].
        direction: unit directions of the edges.
        weight: of every vertex [N].
        normal: outward from the skin at every vertex, unit.
        held: edges that a goal holds.
        bending_stiffness, twisting_stiffness: B and C of human hair [J].
    """

    strands: Float[Tensor, "s n 3"]
    direction: Float[Tensor, "s e 3"]
    weight: Float[Tensor, "s n"]
    normal: Float[Tensor, "s n 3"]
    held: Bool[Tensor, "s e"]
    bending_stiffness: Float[Tensor, "s e"]
    twisting_stiffness: Float[Tensor, "s e"]

    @classmethod
    def of(
        cls, strands: Tensor, weight: Tensor, normal: Tensor, held: Tensor, bending: Tensor, twisting: Tensor
    ) -> "StrandForces":
        """With the directions of the strands' edges."""
        return cls(strands, directors(strands), weight, normal, held, bending, twisting)

    def arrays(self) -> "_Forces":
        return _Forces(*(getattr(self, field.name).contiguous().numpy() for field in fields(self)))


class _Forces(NamedTuple):
    """`StrandForces` as kernels read it."""

    strands: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    normal: np.ndarray
    held: np.ndarray
    bending_stiffness: np.ndarray
    twisting_stiffness: np.ndarray


class _LeastSquares(NamedTuple):
    """One strand's problem: |rows s + constant|^2, its normal equations and their diagonal term."""

    rows: np.ndarray
    constant: np.ndarray
    normal_matrix: np.ndarray
    right: np.ndarray


def solve_support(forces: StrandForces, available: Float[Tensor, "s n"]) -> Float[Tensor, "s n"]:
    """Support force s of every vertex [N].

    Args:
        available: 1 where a vertex can be supported, 0 where not; in between support costs more.
    """
    support = torch.zeros_like(available)
    _supports(forces.arrays(), available.contiguous().numpy(), support.numpy())
    return support


def transmitted_moments(
    forces: StrandForces, support: Float[Tensor, "s n"]
) -> tuple[Float[Tensor, "s e 3"], Float[Tensor, "s e"], Float[Tensor, "s e 3"]]:
    """Bending moment m and twist moment T before every edge, and the moment that its goal takes [N m].

    A held edge does not bend: its goal takes all of the moment but the twist, which runs on to the root.
    """
    bending, goal = torch.zeros_like(forces.direction), torch.zeros_like(forces.direction)
    twisting = torch.zeros_like(forces.bending_stiffness)
    _moments(forces.arrays(), support.contiguous().numpy(), bending.numpy(), twisting.numpy(), goal.numpy())
    return bending, twisting, goal


@njit(cache=True, inline="always")
def _row(array: np.ndarray, index: int) -> Vector:
    return array[index, 0], array[index, 1], array[index, 2]


@njit(cache=True, inline="always")
def split_moment(moment: Vector, before: Vector, direction: Vector) -> tuple[Vector, float]:
    """Bending and twist moment m and T of a joint between edges of directions `before` and `direction`."""
    share = dot(moment, direction) / max(1 + dot(before, direction), LEAST_ALIGNMENT)
    bending = (
        moment[0] - share * (before[0] + direction[0]),
        moment[1] - share * (before[1] + direction[1]),
        moment[2] - share * (before[2] + direction[2]),
    )
    return bending, 0.5 * (dot(moment, before) + dot(moment, direction))


@njit(cache=True, parallel=True)
def _supports(forces: _Forces, available: np.ndarray, support: np.ndarray) -> None:
    strands, edges = forces.bending_stiffness.shape
    for index in prange(strands):
        strand: Any = np.int64(index)  # one type, see `quaffure.energies.stability.stable_factors`
        problem = _LeastSquares(
            np.zeros((edges, edges, 4)), np.zeros((edges, 4)), np.zeros((edges, edges)), np.zeros(edges)
        )
        _fill_rows(forces, strand, available[strand], problem)
        _fill_normal_equations(available[strand], problem)
        _descend(available[strand], forces.weight[strand], problem, support[strand])


@njit(cache=True, inline="always")
def _write_row(row: np.ndarray, moment: Vector, forces: _Forces, strand: int, edge: int) -> None:
    """A moment's bending and twist over the roots of the stiffnesses: the square of the row is its elastic energy."""
    direction = _row(forces.direction[strand], edge)
    bending, twist = split_moment(moment, _row(forces.direction[strand], max(edge - 1, 0)), direction)
    scale = 1 / np.sqrt(forces.bending_stiffness[strand, edge])
    row[0] += scale * bending[0]
    row[1] += scale * bending[1]
    row[2] += scale * bending[2]
    row[3] += twist / np.sqrt(forces.twisting_stiffness[strand, edge])


@njit(cache=True)
def _fill_rows(forces: _Forces, strand: int, available: np.ndarray, problem: _LeastSquares) -> None:
    """Moments of each vertex's weight and of a unit of support there, at every joint that is not held."""
    edges, x = len(problem.right), forces.strands[strand]
    for edge in range(edges):
        if forces.held[strand, edge]:
            continue
        for vertex in range(edge + 1, edges + 1):
            arm = (x[vertex, 0] - x[edge, 0], x[vertex, 1] - x[edge, 1], x[vertex, 2] - x[edge, 2])
            pull = cross(arm, (0.0, 0.0, -forces.weight[strand, vertex]))
            _write_row(problem.constant[edge], pull, forces, strand, edge)
            if available[vertex] > 0:
                push = cross(arm, _row(forces.normal[strand], vertex))
                _write_row(problem.rows[vertex - 1, edge], push, forces, strand, edge)


@njit(cache=True)
def _fill_normal_equations(available: np.ndarray, problem: _LeastSquares) -> None:
    edges = len(problem.right)
    for first in range(edges):
        if available[first + 1] <= 0:
            continue
        for second in range(first + 1):
            total = 0.0
            for edge in range(second + 1):
                for part in range(4):
                    total += problem.rows[first, edge, part] * problem.rows[second, edge, part]
            problem.normal_matrix[first, second] = total
            problem.normal_matrix[second, first] = total
        for edge in range(first + 1):
            for part in range(4):
                problem.right[first] -= problem.rows[first, edge, part] * problem.constant[edge, part]
    trace = 0.0
    for vertex in range(edges):
        trace += problem.normal_matrix[vertex, vertex]
    mean = trace / edges
    for vertex in range(edges):
        share = max(available[vertex + 1], 1e-6)
        problem.normal_matrix[vertex, vertex] += REGULARIZATION * mean * (1 + (1 / share - 1) * DISTANT)


@njit(cache=True)
def _descend(available: np.ndarray, weight: np.ndarray, problem: _LeastSquares, support: np.ndarray) -> None:
    edges = len(problem.right)
    most, beyond = np.empty(len(weight)), 0.0
    for vertex in range(len(weight) - 1, -1, -1):
        beyond += weight[vertex]
        most[vertex] = MOST_SUPPORT * beyond
    for _ in range(SWEEPS):
        for vertex in range(edges):
            if available[vertex + 1] <= 0 or problem.normal_matrix[vertex, vertex] <= 0:
                continue
            slope = problem.right[vertex]
            for other in range(edges):
                slope -= problem.normal_matrix[vertex, other] * support[other + 1]
            best = support[vertex + 1] + slope / problem.normal_matrix[vertex, vertex]
            support[vertex + 1] = min(max(best, 0.0), most[vertex + 1])


@njit(cache=True, parallel=True)
def _moments(forces: _Forces, support: np.ndarray, bending: np.ndarray, twisting: np.ndarray, goal: np.ndarray) -> None:
    for index in prange(len(twisting)):
        strand: Any = np.int64(index)
        _moments_of_strand(forces, strand, support[strand], bending[strand], twisting[strand], goal[strand])


@njit(cache=True)
def _moments_of_strand(
    forces: _Forces, strand: int, support: np.ndarray, bending: np.ndarray, twisting: np.ndarray, goal: np.ndarray
) -> None:
    """From tip to root: the force beyond each edge, its moment, and what of it the joint or the goal takes."""
    x, held = forces.strands[strand], forces.held[strand]
    moment, force = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for edge in range(len(twisting) - 1, -1, -1):
        push, normal = support[edge + 1], _row(forces.normal[strand], edge + 1)
        force = (
            force[0] + push * normal[0],
            force[1] + push * normal[1],
            force[2] + push * normal[2] - forces.weight[strand, edge + 1],
        )
        arm = (x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1], x[edge + 1, 2] - x[edge, 2])
        added = cross(arm, force)
        moment = (moment[0] + added[0], moment[1] + added[1], moment[2] + added[2])
        direction, before = _row(forces.direction[strand], edge), _row(forces.direction[strand], max(edge - 1, 0))
        part, twist = split_moment(moment, before, direction)
        taken = goal if held[edge] else bending
        taken[edge, 0], taken[edge, 1], taken[edge, 2] = part[0], part[1], part[2]
        if held[edge]:
            moment = (moment[0] - part[0], moment[1] - part[1], moment[2] - part[2])
            twist -= 0.5 * dot(part, before)
        twisting[edge] = twist
