"""Eqs. 6, 7, 9 and 10 of whole strands in one compiled pass, value and gradient.

The same terms written out in torch are `HairEnergy` on `Backend.TORCH`; a test holds the two together. A strand's 24
vertices fit in cache, so one pass costs little more than reading them. A vertex looks up whether it is free of the body
or at least outside, where only faces within its margin are sought; where neither is known, the search is bounded by
the distance to the last face that its strand came across.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads, njit, prange
from torch.autograd.function import FunctionCtx

from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.rest_state import RestState
from quaffure.geometry.binary_bvh import LANES, closest_on_triangle, squared_distance
from quaffure.geometry.bvh import BVH_STACK, Bvh, nearest_face
from quaffure.geometry.cell_list import check_finite, interleaved
from quaffure.geometry.occupancy_grid import FREE, OUTSIDE, REACH, OccupancyGrid, classify
from quaffure.geometry.surface import Surface
from quaffure.types import EdgeVectors, Float, Positions, Tensor

TERMS = ("stretch_shear", "stretch", "gravity", "body_collision")
_RUN = 16  # strands that one thread takes in turn: near neighbours, each hands the next a face to start from


class _Body(NamedTuple):
    """One posed body, as the kernel reads it: see `Surface`."""

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
        ValueError: the collision margin is larger than the distance that clear cells keep from the body, a coordinate
            is not finite, or a gradient is asked for that is not computed here.
    """
    check_finite(positions)
    if director.requires_grad or surface.vertices.requires_grad:
        raise ValueError("expected directors and a body without gradient: `Backend.TORCH` differentiates those")
    if material.collision_margin > REACH:
        raise ValueError(f"expected a collision margin up to {REACH} m, found {material.collision_margin}")
    return _StrandEnergy.apply(positions, director, rest, material, surface)


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
        _strands(
            positions.detach().numpy(), director.detach().contiguous().numpy(),
            rest.rest_length.numpy(), rest.mass.numpy(), rest.collision_margin.numpy(), stiffness,
            surface.corners, surface.normals, surface.wide, surface.map,
            get_num_threads(), per_strand, gradient.numpy(),
        )  # fmt: skip
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
    positions: np.ndarray,
    directors: np.ndarray,
    rest_length: np.ndarray,
    mass: np.ndarray,
    margin: np.ndarray,
    stiffness: np.ndarray,
    corners: np.ndarray,
    normals: np.ndarray,
    wide: Bvh,
    space: OccupancyGrid,
    threads: int,
    terms: np.ndarray,
    gradient: np.ndarray,
) -> None:
    batch, strands = positions.shape[:2]
    runs = (strands + _RUN - 1) // _RUN
    for index in prange(batch * runs + threads):
        item = interleaved(index, batch * runs, threads)
        if item >= batch * runs:
            continue
        sample = item // runs
        body = _Body(
            corners[sample],
            normals[sample],
            Bvh(wide.blocks[sample], wide.boxes[sample], wide.levels),
            OccupancyGrid(
                space.origin[sample], space.clear[sample], space.slot[sample], space.outside[sample], space.free[sample]
            ),
        )
        stack, room = np.empty(BVH_STACK, np.int32), np.empty(BVH_STACK + 2 * LANES, np.float32)
        seed = 0
        for strand in range((item % runs) * _RUN, min(strands, (item % runs + 1) * _RUN)):
            x, out, of_strand = positions[sample, strand], gradient[sample, strand], terms[sample, strand]
            of_strand[0], of_strand[1], of_strand[2] = _elastic_and_gravity(
                x, directors[sample, strand], rest_length[strand], mass[strand], stiffness, out
            )
            of_strand[3], seed = _contact(x, margin[strand], stiffness[3], body, seed, stack, room, out)


@njit(cache=True, fastmath=True, inline="always")
def _elastic_and_gravity(
    x: np.ndarray, director: np.ndarray, rest_length: np.ndarray, mass: np.ndarray, stiffness: np.ndarray,
    gradient: np.ndarray,
) -> tuple[float, float, float]:  # fmt: skip
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
        sx, sy, sz = (
            ex * inverse - director[edge, 0],
            ey * inverse - director[edge, 1],
            ez * inverse - director[edge, 2],
        )
        shear += np.float32(0.5) * k_cosserat * (sx * sx + sy * sy + sz * sz)
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        longer = length - rest_length[edge]
        stretch += np.float32(0.5) * k_stretch * longer * longer
        along = k_stretch * longer / (length + np.float32(1e-20))
        across = k_cosserat * inverse
        fx, fy, fz = across * sx + along * ex, across * sy + along * ey, across * sz + along * ez
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
    stack: np.ndarray, room: np.ndarray, gradient: np.ndarray,
) -> tuple[float, int]:  # fmt: skip
    """Eq. 10 of a strand, and the first face that it met: a good `seed` for the next strand."""
    energy, place, first = 0.0, seed, -1
    for vertex in range(1, len(x)):
        px, py, pz = x[vertex, 0], x[vertex, 1], x[vertex, 2]
        where = classify(px, py, pz, body.space)
        if where == FREE:
            continue
        if where == OUTSIDE:
            found = nearest_face(px, py, pz, -1, margin[vertex] * margin[vertex], body.tree, stack, room)
            if found < 0:
                continue
        else:
            squared = squared_distance(body.corners[place], px, py, pz)
            found = nearest_face(px, py, pz, place, squared, body.tree, stack, room)
        place = found
        if first < 0:
            first = found
        energy += _push(
            px, py, pz, margin[vertex], k_body_collision, body.corners[found], body.normals[found], gradient[vertex]
        )
    return energy, (first if first >= 0 else seed)


@njit(cache=True, fastmath=True, inline="always")
def _push(
    px: float, py: float, pz: float, margin: float, k_body_collision: float,
    triangle: np.ndarray, normals: np.ndarray, gradient: np.ndarray,
) -> float:  # fmt: skip
    """Eq. 10 of a vertex whose nearest face is known, its gradient added to `gradient`."""
    cx, cy, cz, feature = closest_on_triangle(triangle, px, py, pz)
    ox, oy, oz = px - cx, py - cy, pz - cz
    nx, ny, nz = normals[feature, 0], normals[feature, 1], normals[feature, 2]
    distance = np.sqrt(ox * ox + oy * oy + oz * oz)
    inside = ox * nx + oy * ny + oz * nz < 0.0
    signed = -distance if inside else distance
    short = margin - signed
    if short <= 0.0:
        return 0.0
    if distance > np.float32(1e-7):
        scale = np.float32(1.0) / signed
        nx, ny, nz = ox * scale, oy * scale, oz * scale
    else:
        scale = np.float32(1.0) / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
    force = np.float32(3.0) * k_body_collision * short * short
    gradient[0] -= force * nx
    gradient[1] -= force * ny
    gradient[2] -= force * nz
    return k_body_collision * short * short * short
