"""Second derivatives of Eqs. 6, 7, 9 and 10 of single strands, in double precision.

An edge couples its two vertices and contact acts on one vertex alone, so the Hessian of a strand is block tridiagonal.
Value and gradient are those of `quaffure.energies.fused_strand`, the twin in single precision. At 1.6 m from the origin
a float32 position is known to 0.1 um, and a stretching stiffness of 1 N/m turns that into a tenth of a vertex's weight:
too coarse for a reference.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.contact_force import contact_force
from quaffure.energies.edge_force import stretch_force, stretch_shear_force
from quaffure.energies.hair_energy import HairEnergy
from quaffure.geometry.surface import SurfaceArrays
from quaffure.solvers.newton.rounded_contact import rounded_distance
from quaffure.types import Float, Tensor

SOFTEST = 0.1
"""Least stiffness of an edge across itself in a convex matrix, of what Eq. 6 alone gives."""


class Hair(NamedTuple):
    """A groom in one pose, float64. `stiffness`: k_cosserat, k_stretch, g, k_body_collision."""

    director: np.ndarray
    rest_length: np.ndarray
    mass: np.ndarray
    margin: np.ndarray
    stiffness: np.ndarray


class StrandSystem(NamedTuple):
    """Gradient and Hessian of strands: of one, or of all with one more axis in front.

    Attributes:
        gradient: [n, 3] [N], zero at the root, which is held.
        diagonal: [n, 3, 3] blocks of the vertices [N/m].
        coupling: [n - 1, 3, 3] blocks between each vertex and the next.
    """

    gradient: np.ndarray
    diagonal: np.ndarray
    coupling: np.ndarray


def hair_arrays(energy: HairEnergy, director: Float[Tensor, "s e 3"]) -> Hair:
    """A groom with the directors of one pose, as the kernels read it."""
    rest, material = energy.rest, energy.material
    stiffness = (material.k_cosserat, material.k_stretch, STANDARD_GRAVITY, material.k_body_collision)
    fields = (director, rest.rest_length, rest.mass, rest.collision_margin)
    directors, rest_length, mass, margin = (field.double().contiguous().numpy() for field in fields)
    return Hair(directors, rest_length, mass, margin, np.array(stiffness))


@njit(cache=True)
def strand_energy(x: np.ndarray, strand: int, hair: Hair, body: SurfaceArrays, leaves: np.ndarray) -> float:
    """Sum of Eqs. 6, 7, 9 and 10 of the vertices `x` [n, 3] of one strand [J].

    Args:
        leaves: [n] where each vertex starts the search for its nearest face; kept up to date.
    """
    along, force, rounding, bending = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    energy = 0.0
    for vertex in range(1, len(x)):
        energy += _edge(x, vertex - 1, strand, hair, along, force)[0]
        energy += hair.mass[strand, vertex] * hair.stiffness[2] * (x[vertex, 2] - x[0, 2])
        margin = hair.margin[strand, vertex]
        distance, leaves[vertex] = rounded_distance(x[vertex], leaves[vertex], margin, body, along, rounding, bending)
        energy += contact_force(distance, margin, hair.stiffness[3])[1]
    return energy


@njit(cache=True)
def strand_hessian(
    x: np.ndarray, strand: int, hair: Hair, body: SurfaceArrays, leaves: np.ndarray, exactness: float,
    system: StrandSystem,
) -> float:  # fmt: skip
    """Energy of one strand; its gradient and Hessian are added up in `system`.

    Args:
        exactness: 1 for the exact Hessian; 0 for a convex one, in which compressed edges keep `SOFTEST` across
            themselves and the body counts as flat; shares of both in between.
    """
    along, force = np.empty(3), np.empty(3)
    system.gradient[:] = 0.0
    system.diagonal[:] = 0.0
    energy = 0.0
    for vertex in range(1, len(x)):
        energy += _add_edge(x, vertex - 1, strand, hair, exactness, along, force, system)
        system.gradient[vertex, 2] += hair.mass[strand, vertex] * hair.stiffness[2]
        energy += hair.mass[strand, vertex] * hair.stiffness[2] * (x[vertex, 2] - x[0, 2])
        energy += _add_contact(x, vertex, strand, hair, body, leaves, exactness, system)
    system.gradient[0] = 0.0
    return energy


@njit(cache=True, inline="always")
def _edge(
    x: np.ndarray, edge: int, strand: int, hair: Hair, along: np.ndarray, force: np.ndarray
) -> tuple[float, float]:
    """Fill the unit vector along an edge and the force in it; return its energy [J] and its length [m]."""
    rest, k_cosserat, k_stretch = hair.rest_length[strand, edge], hair.stiffness[0], hair.stiffness[1]
    for axis in range(3):
        along[axis] = x[edge + 1, axis] - x[edge, axis]
    length = np.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2) + 1e-20
    tension, energy = stretch_force(length, rest, k_stretch)
    for axis in range(3):
        shear, own = stretch_shear_force(along[axis], hair.director[strand, edge, axis], 1.0 / rest, k_cosserat)
        energy += own
        along[axis] /= length
        force[axis] = shear + tension * along[axis]
    return energy, length


@njit(cache=True, inline="always")
def _add_edge(
    x: np.ndarray, edge: int, strand: int, hair: Hair, exactness: float, along: np.ndarray, force: np.ndarray,
    system: StrandSystem,
) -> float:  # fmt: skip
    energy, length = _edge(x, edge, strand, hair, along, force)
    rest = hair.rest_length[strand, edge]
    bending = hair.stiffness[0] / (rest * rest)
    across = bending + hair.stiffness[1] * (1.0 - rest / length)
    across = exactness * across + (1.0 - exactness) * max(across, SOFTEST * bending)
    lengthwise = bending + hair.stiffness[1] - across
    for row in range(3):
        system.gradient[edge, row] -= force[row]
        system.gradient[edge + 1, row] += force[row]
        for column in range(3):
            entry = lengthwise * along[row] * along[column] + (across if row == column else 0.0)
            system.diagonal[edge, row, column] += entry
            system.diagonal[edge + 1, row, column] += entry
            system.coupling[edge, row, column] = -entry
    return energy


@njit(cache=True)
def _add_contact(
    x: np.ndarray, vertex: int, strand: int, hair: Hair, body: SurfaceArrays, leaves: np.ndarray, exactness: float,
    system: StrandSystem,
) -> float:  # fmt: skip
    margin, k = hair.margin[strand, vertex], hair.stiffness[3]
    normal, rounding, bending = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    distance, leaves[vertex] = rounded_distance(x[vertex], leaves[vertex], margin, body, normal, rounding, bending)
    short = margin - distance
    if short <= 0.0:
        return 0.0
    (slope, energy), stiff = contact_force(distance, margin, k), 6.0 * k * short
    kept = exactness if distance > 0.0 else 1.0
    for row in range(3):
        system.gradient[vertex, row] += slope * normal[row]
        for column in range(3):
            bent = kept * bending[row, column] - rounding[row, column]
            system.diagonal[vertex, row, column] += stiff * normal[row] * normal[column] + slope * bent
    return energy
