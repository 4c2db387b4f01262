"""Eqs. 6, 7, 9 and 10 of whole strands in one compiled pass, value and gradient.

The same terms written out in torch are `HairEnergy` on `Backend.TORCH`; a test holds the two together. A strand's 24
vertices fit in cache, so one pass costs little more than reading them.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.config import HairMaterial
from quaffure.energies.body_collision import contact_force
from quaffure.energies.gravity import GRAVITY, Acceleration
from quaffure.energies.known_gradient import with_gradient
from quaffure.energies.rest_state import RestState
from quaffure.energies.stretch import stretch_force
from quaffure.energies.stretch_shear import stretch_shear_force
from quaffure.geometry.bvh import search_workspace
from quaffure.geometry.cell_list import check_finite, interleaved
from quaffure.geometry.surface import Surface, SurfaceArrays, sample_arrays
from quaffure.geometry.surface_distance import distance_within
from quaffure.types import EdgeVectors, Float, Positions, Tensor

TERMS = ("stretch_shear", "stretch", "gravity", "body_collision")
_RUN = 16  # strands that one thread takes in turn: near neighbours, each finds a face that the next starts from


class _Strands(NamedTuple):
    """A groom: unit directors [b, s, e, 3], and by strand rest lengths [m], masses [kg], collision margins [m].

    `stiffness`: k_cosserat, k_stretch, k_body_collision. `acceleration`: g [m/s^2].
    """

    director: np.ndarray
    rest_length: np.ndarray
    mass: np.ndarray
    margin: np.ndarray
    stiffness: np.ndarray
    acceleration: np.ndarray


def strand_energy(
    positions: Positions,
    director: EdgeVectors,
    rest: RestState,
    material: HairMaterial,
    surface: Surface,
    acceleration: Acceleration = GRAVITY,
) -> tuple[Float[Tensor, " b"], Float[Tensor, "b 4"]]:
    """Sum of Eqs. 6, 7, 9 and 10 [J], differentiable in the positions alone, and the four `TERMS` without gradient.

    Args:
        positions: draped vertices [m], float32, on the CPU.
        director: unit d3 of every edge.
        rest: of the same groom.
        surface: the posed body of every sample.
        acceleration: g of Eq. 9.

    Raises:
        ValueError: a coordinate is not finite, or a gradient is required that is not computed here.
    """
    check_finite(positions)
    if torch.is_grad_enabled() and (director.requires_grad or surface.vertices.requires_grad):
        raise ValueError("expected directors and a body without gradient: `Backend.TORCH` differentiates those")
    vertices = positions.detach().contiguous()
    gradient, per_strand = torch.empty_like(vertices), np.empty((*vertices.shape[:2], len(TERMS)), np.float64)
    stiffness = np.array((material.k_cosserat, material.k_stretch, material.k_body_collision), np.float32)
    directors, margin = director.detach().contiguous().numpy(), rest.collision_margin.numpy()
    hair = _Strands(
        directors, rest.rest_length.numpy(), rest.mass.numpy(), margin, stiffness, np.array(acceleration, np.float32)
    )
    _strands(vertices.numpy(), hair, surface.arrays, get_num_threads(), per_strand, gradient.numpy())
    terms = torch.from_numpy(per_strand.sum(axis=1)).to(positions.dtype)
    return with_gradient(positions, terms.sum(dim=1), gradient), terms


@njit(cache=True, parallel=True, fastmath=True)
def _strands(
    positions: np.ndarray, hair: _Strands, surface: SurfaceArrays, threads: int, terms: np.ndarray, gradient: np.ndarray
) -> None:
    batch, strands = positions.shape[:2]
    runs = (strands + _RUN - 1) // _RUN
    for index in prange(batch * runs + threads):
        item = interleaved(index, batch * runs, threads)
        if item >= batch * runs:
            continue
        sample = item // runs
        body = sample_arrays(surface, sample)
        workspace = search_workspace()
        contact = np.empty((positions.shape[2], 4), np.float32)
        seed = int(np.int64(0))  # a literal would be a type of its own, for which the search is compiled again
        for strand in range((item % runs) * _RUN, min(strands, (item % runs + 1) * _RUN)):
            x, out, own_terms = positions[sample, strand], gradient[sample, strand], terms[sample, strand]
            own_terms[0], own_terms[1], own_terms[2] = _elastic_and_gravity(
                x,
                hair.director[sample, strand],
                hair.rest_length[strand],
                hair.mass[strand],
                hair.stiffness,
                hair.acceleration,
                out,
            )
            own_terms[3], seed = contact_of_strand(
                x, hair.margin[strand], hair.stiffness[2], body, seed, workspace, out, contact
            )


@njit(cache=True, fastmath=True, inline="always")
def _elastic_and_gravity(
    x: np.ndarray, director: np.ndarray, rest_length: np.ndarray, mass: np.ndarray, stiffness: np.ndarray,
    acceleration: np.ndarray, gradient: np.ndarray,
) -> tuple[float, float, float]:  # fmt: skip
    """Eqs. 6, 7 and 9 of a strand; fills its gradient."""
    k_cosserat, k_stretch = stiffness[0], stiffness[1]
    shear, stretch = 0.0, 0.0
    weight = gravity_of_strand(x, mass, acceleration, gradient)
    for edge in range(len(rest_length)):
        ex, ey, ez = x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1], x[edge + 1, 2] - x[edge, 2]
        inverse = np.float32(1.0) / rest_length[edge]
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        tension, energy = stretch_force(length, rest_length[edge], k_stretch)
        stretch += energy
        along = tension / (length + np.float32(1e-20))
        for axis in range(3):
            component = x[edge + 1, axis] - x[edge, axis]
            force, energy = stretch_shear_force(component, director[edge, axis], inverse, k_cosserat)
            shear += energy
            force += along * component
            gradient[edge, axis] -= force
            gradient[edge + 1, axis] += force
    return shear, stretch, weight


@njit(cache=True, fastmath=True, inline="always")
def gravity_of_strand(x: np.ndarray, mass: np.ndarray, acceleration: np.ndarray, gradient: np.ndarray) -> float:
    """Eq. 9 of a strand, from its root; fills the gradient."""
    energy = 0.0
    for vertex in range(len(mass)):
        for axis in range(3):
            force = mass[vertex] * acceleration[axis]
            gradient[vertex, axis] = -force
            energy -= force * (x[vertex, axis] - x[0, axis])
    return energy


@njit(cache=True, fastmath=True, inline="always")
def contact_of_strand(
    x: np.ndarray, margin: np.ndarray, k_body_collision: float | np.floating, body: SurfaceArrays, seed: int,
    workspace: tuple[np.ndarray, np.ndarray], gradient: np.ndarray, contact: np.ndarray,
) -> tuple[float, int]:  # fmt: skip
    """Eq. 10 of a strand, and the first face in contact: a good `seed` for the next strand. Adds to the gradient.

    Fills `contact` [vertex 4] where a face is found: unit normal, and how far within its margin the vertex is [m].
    """
    energy, leaf, first = 0.0, seed, -1
    for vertex in range(1, len(x)):
        distance, nx, ny, nz, found = distance_within(
            x[vertex, 0], x[vertex, 1], x[vertex, 2], margin[vertex], leaf, body, workspace
        )
        if found < 0:
            continue
        leaf = found
        if first < 0:
            first = found
        contact[vertex, 0], contact[vertex, 1], contact[vertex, 2] = nx, ny, nz
        contact[vertex, 3] = max(margin[vertex] - distance, np.float32(0.0))
        slope, own_energy = contact_force(distance, margin[vertex], k_body_collision)
        energy += own_energy
        gradient[vertex, 0] += slope * nx
        gradient[vertex, 1] += slope * ny
        gradient[vertex, 2] += slope * nz
    return energy, (first if first >= 0 else seed)
