"""Eqs. 6, 7, 9 and 10 of whole strands in one compiled pass, value and gradient.

The same terms written out in torch are `HairEnergy` on `Backend.TORCH`; a test holds the two together. A strand's 24
vertices fit in cache, so one pass costs little more than reading them. An occupancy grid tells where a vertex is free
of the body, or at least outside, where only faces within its margin are searched; where neither is known, the search is
bounded by the distance to the last face found for the strand.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads, njit, prange
from torch.autograd.function import FunctionCtx

from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.contact_force import contact_force
from quaffure.energies.edge_force import stretch_force, stretch_shear_force
from quaffure.energies.rest_state import RestState
from quaffure.geometry.bvh import Bvh, nearest_face, search_workspace
from quaffure.geometry.cell_list import check_finite, interleaved
from quaffure.geometry.occupancy_grid import FREE, FREE_DISTANCE, UNKNOWN, OccupancyGrid, classify
from quaffure.geometry.surface import Surface, SurfaceArrays, bvh_of, occupancy_of, sample_arrays
from quaffure.geometry.triangle import closest_on_triangle, signed_distance_from_offset, squared_distance
from quaffure.types import EdgeVectors, Float, Positions, Tensor

TERMS = ("stretch_shear", "stretch", "gravity", "body_collision")
_RUN = 16  # strands that one thread takes in turn: near neighbours, each finds a face that the next starts from


class _Strands(NamedTuple):
    """A groom: unit directors [b, s, e, 3], and by strand rest lengths [m], masses [kg], collision margins [m].

    `stiffness`: k_cosserat, k_stretch, g, k_body_collision.
    """

    director: np.ndarray
    rest_length: np.ndarray
    mass: np.ndarray
    margin: np.ndarray
    stiffness: np.ndarray


class _Body(NamedTuple):
    """One posed body: see `SurfaceArrays`."""

    corners: np.ndarray
    normals: np.ndarray
    tree: Bvh
    space: OccupancyGrid


def strand_energy(
    positions: Positions, director: EdgeVectors, rest: RestState, material: HairMaterial, surface: Surface
) -> tuple[Float[Tensor, " b"], Float[Tensor, "b 4"]]:
    """Sum of Eqs. 6, 7, 9 and 10 [J], differentiable in the positions alone, and the four `TERMS` without gradient.

    Args:
        positions: draped vertices [m], float32, on the CPU.
        director: unit d3 of every edge.
        rest: of the same groom.
        surface: the posed body of every sample.

    Raises:
        ValueError: a coordinate is not finite, or a gradient is required that is not computed here.
    """
    check_finite(positions)
    if director.requires_grad or surface.vertices.requires_grad:
        raise ValueError("expected directors and a body without gradient: `Backend.TORCH` differentiates those")
    return _StrandEnergy.apply(positions, director, rest, material, surface)  # type: ignore[no-untyped-call]


class _StrandEnergy(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx,
        positions: Tensor,
        director: Tensor,
        rest: RestState,
        material: HairMaterial,
        surface: Surface,
    ) -> tuple[Tensor, Tensor]:
        positions = positions.contiguous()
        gradient = torch.empty_like(positions)
        per_strand = np.empty((*positions.shape[:2], len(TERMS)), np.float64)
        stiffness = np.array(
            [material.k_cosserat, material.k_stretch, STANDARD_GRAVITY, material.k_body_collision], np.float32
        )
        directors, margin = director.detach().contiguous().numpy(), rest.collision_margin.numpy()
        strands = _Strands(directors, rest.rest_length.numpy(), rest.mass.numpy(), margin, stiffness)
        arrays, threads = surface.arrays, get_num_threads()
        _strands(positions.detach().numpy(), strands, arrays, threads, per_strand, gradient.numpy())
        ctx.save_for_backward(gradient)
        terms = torch.from_numpy(per_strand.sum(axis=1)).to(positions.dtype)
        ctx.mark_non_differentiable(terms)
        return terms.sum(dim=1), terms

    @staticmethod
    def backward(ctx: FunctionCtx, *upstream: Tensor) -> tuple[Tensor, None, None, None, None]:
        (gradient,) = ctx.saved_tensors  # type: ignore[attr-defined]
        return gradient * upstream[0][:, None, None, None], None, None, None, None


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
        arrays = sample_arrays(surface, sample)
        body = _Body(arrays.corners, arrays.normals, bvh_of(arrays), occupancy_of(arrays))
        stack, scratch = search_workspace()
        seed = 0
        for strand in range((item % runs) * _RUN, min(strands, (item % runs + 1) * _RUN)):
            x, out, own_terms = positions[sample, strand], gradient[sample, strand], terms[sample, strand]
            own_terms[0], own_terms[1], own_terms[2] = _elastic_and_gravity(
                x, hair.director[sample, strand], hair.rest_length[strand], hair.mass[strand], hair.stiffness, out
            )
            own_terms[3], seed = _contact(x, hair.margin[strand], hair.stiffness[3], body, seed, stack, scratch, out)


@njit(cache=True, fastmath=True, inline="always")
def _elastic_and_gravity(
    x: np.ndarray, director: np.ndarray, rest_length: np.ndarray, mass: np.ndarray, stiffness: np.ndarray,
    gradient: np.ndarray,
) -> tuple[float, float, float]:  # fmt: skip
    """Eqs. 6, 7 and 9 of a strand; fills its gradient."""
    k_cosserat, k_stretch, gravity = stiffness[0], stiffness[1], stiffness[2]
    shear, stretch, height = 0.0, 0.0, 0.0
    for vertex in range(len(mass)):
        gradient[vertex, 0] = 0.0
        gradient[vertex, 1] = 0.0
        gradient[vertex, 2] = mass[vertex] * gravity
        height += mass[vertex] * gravity * (x[vertex, 2] - x[0, 2])
    for edge in range(len(rest_length)):
        ex, ey, ez = x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1], x[edge + 1, 2] - x[edge, 2]
        inverse = np.float32(1.0) / rest_length[edge]
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        tension, energy = stretch_force(length, rest_length[edge], k_stretch)
        stretch += energy
        along = tension / (length + np.float32(1e-20))
        fx, energy_x = stretch_shear_force(ex, director[edge, 0], inverse, k_cosserat)
        fy, energy_y = stretch_shear_force(ey, director[edge, 1], inverse, k_cosserat)
        fz, energy_z = stretch_shear_force(ez, director[edge, 2], inverse, k_cosserat)
        shear += energy_x + energy_y + energy_z
        fx, fy, fz = fx + along * ex, fy + along * ey, fz + along * ez
        gradient[edge, 0] -= fx
        gradient[edge, 1] -= fy
        gradient[edge, 2] -= fz
        gradient[edge + 1, 0] += fx
        gradient[edge + 1, 1] += fy
        gradient[edge + 1, 2] += fz
    return shear, stretch, height


@njit(cache=True, fastmath=True, inline="always")
def _contact(
    x: np.ndarray, margin: np.ndarray, k_body_collision: float, body: _Body, seed: int,
    stack: np.ndarray, scratch: np.ndarray, gradient: np.ndarray,
) -> tuple[float, int]:  # fmt: skip
    """Eq. 10 of a strand, and the first face in contact: a good `seed` for the next strand. Adds to the gradient."""
    energy, leaf, first = 0.0, seed, -1
    for vertex in range(1, len(x)):
        px, py, pz = x[vertex, 0], x[vertex, 1], x[vertex, 2]
        where = classify(px, py, pz, body.space)
        if where == FREE and margin[vertex] <= np.float32(FREE_DISTANCE):
            continue
        if where == UNKNOWN:
            squared = squared_distance(body.corners[leaf], px, py, pz)
            found = nearest_face(px, py, pz, leaf, squared, body.tree, stack, scratch)
        else:  # outside: faces beyond the margin do not matter
            found = nearest_face(px, py, pz, -1, margin[vertex] * margin[vertex], body.tree, stack, scratch)
            if found < 0:
                continue
        leaf = found
        if first < 0:
            first = found
        cx, cy, cz, feature = closest_on_triangle(body.corners[found], px, py, pz)
        nx, ny, nz = body.normals[found, feature]
        distance, nx, ny, nz = signed_distance_from_offset(px - cx, py - cy, pz - cz, nx, ny, nz)
        slope, own_energy = contact_force(distance, margin[vertex], k_body_collision)
        energy += own_energy
        gradient[vertex, 0] += slope * nx
        gradient[vertex, 1] += slope * ny
        gradient[vertex, 2] += slope * nz
    return energy, (first if first >= 0 else seed)
