"""Strands as unit directions: integrated from the root, their edges keep their rest lengths exactly."""

import numpy as np
import torch
from numba import njit, prange
from torch.autograd.function import FunctionCtx

from quaffure.types import EdgeVectors, Float, Int, Positions, RestLengths, Tensor


def edges(positions: Float[Tensor, "*batch n 3"]) -> Float[Tensor, "*batch e 3"]:
    """Vectors from each vertex to the next [m]."""
    return positions[..., 1:, :] - positions[..., :-1, :]


def directors(posed: Float[Tensor, "*batch n 3"]) -> Float[Tensor, "*batch e 3"]:
    """Unit directors d3 of the rigidly posed groom."""
    return torch.nn.functional.normalize(edges(posed), dim=-1)


def arc_lengths(strands: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n"]:
    """Length of each strand from its root to each vertex [m]."""
    return torch.nn.functional.pad(strands.diff(dim=1).norm(dim=-1).cumsum(1), (1, 0))


def interpolate_vertices(
    strands: Float[Tensor, "s n 3"], left: Int[Tensor, "s m"], weight: Float[Tensor, "s m"]
) -> Float[Tensor, "s m 3"]:
    """Points between the vertices `left` (weight 0) and their successors (weight 1)."""
    index = left[..., None].expand(-1, -1, 3)
    weight = weight[..., None]
    return (1 - weight) * strands.gather(1, index) + weight * strands.gather(1, index + 1)


def points_along(polylines: Float[Tensor, "s n 3"], arc_length: Float[Tensor, "s m"]) -> Float[Tensor, "s m 3"]:
    """Points of polylines at arc lengths from their first vertices [m]; beyond the end, the end."""
    lengths = arc_lengths(polylines)
    right = torch.searchsorted(lengths, arc_length.contiguous()).clamp(1, polylines.shape[1] - 1)
    start, end = lengths.gather(1, right - 1), lengths.gather(1, right)
    share = ((arc_length - start) / (end - start).clamp(min=1e-9)).clamp(0, 1)
    return interpolate_vertices(polylines, right - 1, share)


def integrate_directions_reference(
    root: Float[Tensor, "b s 3"], vectors: EdgeVectors, rest_length: RestLengths
) -> Positions:
    """Torch twin of `integrate_directions`."""
    steps = rest_length[..., None] * torch.nn.functional.normalize(vectors, dim=-1)
    return torch.cat([root[:, :, None], root[:, :, None] + steps.cumsum(dim=2)], dim=2)


def integrate_directions(root: Float[Tensor, "b s 3"], vectors: EdgeVectors, rest_length: RestLengths) -> Positions:
    """Vertices of strands whose edges point along `vectors` (any length but zero) and measure `rest_length` [m].

    Differentiable once. Compiled on the CPU in float32 where the roots need no gradient, the twin elsewhere.
    """
    if vectors.device.type != "cpu" or vectors.dtype != torch.float32 or root.requires_grad:
        return integrate_directions_reference(root, vectors, rest_length)
    return _IntegrateDirections.apply(vectors, root, rest_length)  # type: ignore[no-untyped-call]


class _IntegrateDirections(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, vectors: Tensor, root: Tensor, rest_length: Tensor) -> Tensor:
        vectors = vectors.contiguous()
        ctx.save_for_backward(vectors, rest_length)
        batch, strands, edges, _ = vectors.shape
        positions = torch.empty(batch, strands, edges + 1, 3)
        _integrate(root.contiguous().numpy(), vectors.numpy(), rest_length.contiguous().numpy(), positions.numpy())
        return positions

    @staticmethod
    def backward(ctx: FunctionCtx, *upstream: Tensor) -> tuple[Tensor, None, None]:
        vectors, rest_length = ctx.saved_tensors  # type: ignore[attr-defined]
        gradient = torch.empty_like(vectors)
        _integrate_adjoint(
            upstream[0].contiguous().numpy(), vectors.numpy(), rest_length.contiguous().numpy(), gradient.numpy()
        )
        return gradient, None, None


@njit(cache=True, parallel=True, fastmath=True)
def _integrate(root: np.ndarray, vectors: np.ndarray, rest_length: np.ndarray, positions: np.ndarray) -> None:
    batch, strands = vectors.shape[:2]
    for index in prange(batch * strands):
        sample, strand = index // strands, index % strands
        integrate_strand(
            root[sample, strand], vectors[sample, strand], rest_length[strand], False, positions[sample, strand]
        )


@njit(cache=True, fastmath=True, inline="always")
def integrate_strand(
    root: np.ndarray, vectors: np.ndarray, length: np.ndarray, are_unit: bool, positions: np.ndarray
) -> None:
    """Fill the vertices [vertex 3] of one strand whose edges point along `vectors`. Where these are unit vectors, the
    constant `are_unit` saves their norms: the branch goes when the function is inlined."""
    x, y, z = root[0], root[1], root[2]
    positions[0, 0], positions[0, 1], positions[0, 2] = x, y, z
    for edge in range(len(length)):
        vx, vy, vz = vectors[edge, 0], vectors[edge, 1], vectors[edge, 2]
        scale = length[edge]
        if not are_unit:
            scale /= np.sqrt(vx * vx + vy * vy + vz * vz + np.float32(1e-24))
        x += scale * vx
        y += scale * vy
        z += scale * vz
        positions[edge + 1, 0], positions[edge + 1, 1], positions[edge + 1, 2] = x, y, z


@njit(cache=True, parallel=True, fastmath=True)
def _integrate_adjoint(
    upstream: np.ndarray, vectors: np.ndarray, rest_length: np.ndarray, gradient: np.ndarray
) -> None:
    batch, strands, edges, _ = vectors.shape
    zero = np.float32(0.0)
    for index in prange(batch * strands):
        sample, strand = index // strands, index % strands
        gx, gy, gz = zero, zero, zero  # of all vertices beyond the edge
        for edge in range(edges - 1, -1, -1):
            gx += upstream[sample, strand, edge + 1, 0]
            gy += upstream[sample, strand, edge + 1, 1]
            gz += upstream[sample, strand, edge + 1, 2]
            vx, vy, vz = vectors[sample, strand, edge]
            inverse = np.float32(1.0) / np.sqrt(vx * vx + vy * vy + vz * vz + np.float32(1e-24))
            vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
            along = gx * vx + gy * vy + gz * vz
            scale = rest_length[strand, edge] * inverse
            gradient[sample, strand, edge, 0] = scale * (gx - along * vx)
            gradient[sample, strand, edge, 1] = scale * (gy - along * vy)
            gradient[sample, strand, edge, 2] = scale * (gz - along * vz)
