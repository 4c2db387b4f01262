"""The strands' part of a Newton step, compiled: every strand is a block-tridiagonal system of its own."""

import numpy as np
from numba import njit, prange

from quaffure.geometry.surface import SurfaceArrays
from quaffure.solvers.newton.block_tridiagonal import factor_strand
from quaffure.solvers.newton.strand_hessian import Hair, StrandSystem, strand_energy, strand_hessian

LEAST_SHARE = 0.2
"""No edge shrinks below this share of its length in one step."""
SHORTEST_EDGE = 1e-12
"""An edge shorter than this has no direction [m]."""


@njit(cache=True, parallel=True)
def strand_energies(
    positions: np.ndarray, hair: Hair, body: SurfaceArrays, leaves: np.ndarray, energies: np.ndarray
) -> None:
    """Fill the energy of every strand [J]; `leaves` as in `strand_energy`."""
    for strand in prange(len(positions)):
        energies[strand] = strand_energy(positions[strand], strand, hair, body, leaves[strand])


@njit(cache=True, parallel=True)
def linearize_strands(
    positions: np.ndarray, hair: Hair, body: SurfaceArrays, leaves: np.ndarray, exactness: float, system: StrandSystem
) -> None:
    """Fill gradient and Hessian of every strand; `exactness` as in `strand_hessian`."""
    for strand in prange(len(positions)):
        one = StrandSystem(system.gradient[strand], system.diagonal[strand], system.coupling[strand])
        strand_hessian(positions[strand], strand, hair, body, leaves[strand], exactness, one)


@njit(cache=True, parallel=True)
def factor_strands(diagonal: np.ndarray, coupling: np.ndarray, pivot_inverse: np.ndarray) -> None:
    """`factor_strand` for every strand."""
    for strand in prange(len(diagonal)):
        factor_strand(diagonal[strand], coupling[strand], pivot_inverse[strand])


@njit(cache=True, parallel=True)
def multiply_strands(diagonal: np.ndarray, coupling: np.ndarray, step: np.ndarray, product: np.ndarray) -> None:
    """Fill the product of the strands' Hessians and a step [s, n, 3], zero at the roots."""
    vertices = diagonal.shape[1]
    for strand in prange(len(diagonal)):
        product[strand, 0] = 0.0
        for vertex in range(1, vertices):
            for row in range(3):
                total = 0.0
                for column in range(3):
                    total += diagonal[strand, vertex, row, column] * step[strand, vertex, column]
                    if vertex > 1:
                        total += coupling[strand, vertex - 1, row, column] * step[strand, vertex - 1, column]
                    if vertex < vertices - 1:
                        total += coupling[strand, vertex, row, column] * step[strand, vertex + 1, column]
                product[strand, vertex, row] = total


@njit(cache=True, parallel=True)
def turn_edges(positions: np.ndarray, step: np.ndarray, moved: np.ndarray) -> None:
    """Fill where a step [s, n, 3] leads when edges turn along arcs: what is across an edge does not lengthen it.

    To first order `positions` + `step`, without the stretching of second order that a straight step brings.
    """
    for strand in prange(len(positions)):
        moved[strand, 0] = positions[strand, 0]
        edge, turned = np.empty(3), np.empty(3)
        for vertex in range(1, positions.shape[1]):
            edge[:] = positions[strand, vertex] - positions[strand, vertex - 1]
            turned[:] = edge + step[strand, vertex] - step[strand, vertex - 1]
            length = np.sqrt((edge * edge).sum())
            if length < SHORTEST_EDGE:
                # No direction to turn from.
                moved[strand, vertex] = moved[strand, vertex - 1] + turned
                continue
            wanted = max((edge * turned).sum() / length, LEAST_SHARE * length)
            moved[strand, vertex] = moved[strand, vertex - 1] + turned * (
                wanted / max(np.sqrt((turned * turned).sum()), SHORTEST_EDGE)
            )
