"""Eqs. 6, 7, 9 and 10 of whole strands in one compiled pass, value and gradient.

The same terms written out in torch are `HairEnergy.reference_terms`; a test holds the two together. A strand's 24
vertices fit in cache, so one pass costs little more than reading them, and each vertex starts its search for the
nearest face from its neighbour's.
"""

import numpy as np
import torch
from numba import njit, prange
from torch.autograd.function import FunctionCtx

from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.rest_state import RestState
from quaffure.geometry.clear_cells import REACH, is_clear
from quaffure.geometry.face_tree import MAX_DEPTH, closest_on_triangle, search
from quaffure.geometry.neighbors import check_finite
from quaffure.geometry.surface import Surface
from quaffure.types import EdgeVectors, Float, Positions, Tensor

TERMS = ("stretch_shear", "stretch", "gravity", "body_collision")


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
        raise ValueError("expected directors and a body without gradient: `reference_terms` differentiates those")
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
        tree = surface.topology.tree
        stiffness = np.array(
            [material.k_cosserat, material.k_stretch, STANDARD_GRAVITY, material.k_body_collision], np.float32
        )
        _strands(
            positions.detach().numpy(), director.detach().contiguous().numpy(),
            rest.rest_length.numpy(), rest.mass.numpy(), rest.collision_margin.numpy(), stiffness,
            surface.corners, surface.normals, surface.bounds, tree.first, tree.second,
            surface.clear_origin, surface.clear,
            per_strand, gradient.numpy(),
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
    bounds: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    clear_origin: np.ndarray,
    clear: np.ndarray,
    terms: np.ndarray,
    gradient: np.ndarray,
) -> None:
    batch, strands = positions.shape[:2]
    for index in prange(batch * strands):
        sample, strand = index // strands, index % strands
        x, out = positions[sample, strand], gradient[sample, strand]
        terms[sample, strand, 0], terms[sample, strand, 1], terms[sample, strand, 2] = _elastic_and_gravity(
            x, directors[sample, strand], rest_length[strand], mass[strand], stiffness, out
        )
        terms[sample, strand, 3] = _contact(
            x,
            margin[strand],
            stiffness[3],
            corners[sample],
            normals[sample],
            bounds[sample],
            first,
            second,
            clear_origin[sample],
            clear[sample],
            out,
        )


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
    x: np.ndarray, margin: np.ndarray, k_body_collision: float,
    corners: np.ndarray, normals: np.ndarray, bounds: np.ndarray, first: np.ndarray, second: np.ndarray,
    clear_origin: np.ndarray, clear: np.ndarray, gradient: np.ndarray,
) -> float:  # fmt: skip
    stack = np.empty(MAX_DEPTH, np.int32)
    place = search(x[0], 0, corners, bounds, first, second, stack)
    energy = 0.0
    for vertex in range(1, len(x)):
        if is_clear(x[vertex, 0], x[vertex, 1], x[vertex, 2], clear_origin, clear):
            continue
        place = search(x[vertex], place, corners, bounds, first, second, stack)
        px, py, pz = x[vertex, 0], x[vertex, 1], x[vertex, 2]
        cx, cy, cz, feature = closest_on_triangle(corners[place], px, py, pz)
        ox, oy, oz = px - cx, py - cy, pz - cz
        nx, ny, nz = normals[place, feature, 0], normals[place, feature, 1], normals[place, feature, 2]
        distance = np.sqrt(ox * ox + oy * oy + oz * oz)
        inside = ox * nx + oy * ny + oz * nz < 0.0
        signed = -distance if inside else distance
        short = margin[vertex] - signed
        if short <= 0.0:
            continue
        energy += k_body_collision * short * short * short
        if distance > np.float32(1e-7):
            scale = np.float32(1.0) / signed
            nx, ny, nz = ox * scale, oy * scale, oz * scale
        else:
            scale = np.float32(1.0) / np.sqrt(nx * nx + ny * ny + nz * nz)
            nx, ny, nz = nx * scale, ny * scale, nz * scale
        force = np.float32(3.0) * k_body_collision * short * short
        gradient[vertex, 0] -= force * nx
        gradient[vertex, 1] -= force * ny
        gradient[vertex, 2] -= force * nz
    return energy
