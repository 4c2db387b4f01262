"""A smooth, approximate surface made of oriented points, and strands that slide along it.

A moving-least-squares surface (Shen et al. 2004) with weights of compact support: a few hundred points stand for a
body, nothing has to be built when they move, and distances and normals change without jumps. It gives the network its
starting point and its view of the body; energies and figures of merit use the exact surface
(`quaffure.geometry.signed_distance`).
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import njit, prange

from quaffure.types import EdgeVectors, Float, RestLengths, Tensor

LEAF = 8
"""Points of a leaf: one look at its bounding sphere spares all of them."""
VIEW_CHANNELS = 5
"""What a vertex sees: mean distance over the radius, mean normal, and how much there is to see."""
# Sum of weights at which a view counts half: far from all points every channel fades to zero.
_FAINT = 0.02
# Edges for which the leaves in reach are listed at once.
_STRIDE = 4


class SoftSurface(NamedTuple):
    """A batch of poses of one set of oriented points, in leaves of near neighbours.

    Attributes:
        points: positions [m].
        normals: unit, outwards.
        radius: reach of a point [m].
    """

    points: Float[Tensor, "b leaf 8 3"]
    normals: Float[Tensor, "b leaf 8 3"]
    radius: float


def soft_views(points: Float[Tensor, "b p 3"], surface: SoftSurface) -> Float[Tensor, "b p 5"]:
    """What oriented points of a surface say of places near it.

    Returns:
        Mean signed distance over the radius, mean normal, and how much there is to see; all 0 far away.
    """
    # A strand of one edge without length looks from where it begins, and turns nowhere.
    nowhere = points.new_zeros(points.shape[1], 1)
    margin = points.new_full((points.shape[1], 2), -1e3)
    return slide(points, torch.ones_like(points)[:, :, None], nowhere, margin, surface)[1][:, :, 0]


def soft_views_reference(points: Float[Tensor, "b p 3"], surface: SoftSurface) -> Float[Tensor, "b p 5"]:
    """Torch twin of `soft_views`."""
    offset = points[:, :, None] - surface.points.flatten(1, 2)[:, None]
    weight = (1 - offset.square().sum(-1) / surface.radius**2).clamp(min=0) ** 4
    normals = surface.normals.flatten(1, 2)
    height = (offset * normals[:, None]).sum(-1)
    whole = weight.sum(-1, keepdim=True)
    parts = [(weight * height).sum(-1, keepdim=True) / surface.radius, weight @ normals, whole]
    return torch.cat(parts, dim=-1) / (whole + _FAINT)


def slide_reference(
    root: Float[Tensor, "b s 3"],
    vectors: EdgeVectors,
    rest_length: RestLengths,
    margin: Float[Tensor, "s n"],
    surface: SoftSurface,
) -> tuple[EdgeVectors, Float[Tensor, "b s e 5"]]:
    """Torch twin of `slide`."""
    place, edges, views = root, [], []
    for edge in range(vectors.shape[2]):
        length = rest_length[:, edge, None]
        direction = torch.nn.functional.normalize(vectors[:, :, edge], dim=-1)
        for _ in range(2):
            view = soft_views_reference(place + length * direction, surface)
            direction = _deflected(direction, view, length, margin[:, edge + 1, None], surface.radius)
        place = place + length * direction
        edges.append(direction)
        views.append(view)
    return torch.stack(edges, dim=2), torch.stack(views, dim=2)


def _deflected(
    direction: Float[Tensor, "b s 3"], view: Float[Tensor, "b s 5"], length: Tensor, margin: Tensor, radius: float
) -> Float[Tensor, "b s 3"]:
    short = (margin * view[..., 4:] - radius * view[..., :1]).clamp(min=0)
    return torch.nn.functional.normalize(direction + short / length * view[..., 1:4], dim=-1)


def slide(
    root: Float[Tensor, "b s 3"],
    vectors: EdgeVectors,
    rest_length: RestLengths,
    margin: Float[Tensor, "s n"],
    surface: SoftSurface,
) -> tuple[EdgeVectors, Float[Tensor, "b s e 5"]]:
    """Strands grown edge by edge along `vectors`, each edge turned out of the surface that its end would be in.

    Growing from the root, a strand is never deep inside, so it always leaves on the side on which it came.

    Args:
        root: where strands begin [m].
        vectors: where their edges would point, of any length but zero.
        rest_length: of the edges [m].
        margin: distance that each vertex is to keep [m].

    Returns:
        Unit edges, and what the end of each sees of the surface. No gradient flows.
    """
    if vectors.device.type != "cpu" or vectors.dtype != torch.float32:
        return slide_reference(root, vectors, rest_length, margin, surface)
    edges = torch.empty_like(vectors, memory_format=torch.contiguous_format)
    views = torch.empty(*vectors.shape[:3], VIEW_CHANNELS)
    centres = surface.points.mean(dim=2)
    reach = (surface.points - centres[:, :, None]).norm(dim=-1).amax(dim=2) + surface.radius
    leaves = torch.cat([surface.points, surface.normals], dim=-1).mT.contiguous()
    _slide(
        root.detach().contiguous().numpy(), vectors.detach().contiguous().numpy(), rest_length.contiguous().numpy(),
        margin.contiguous().numpy(), leaves.detach().numpy(),
        torch.cat([centres, reach[..., None]], dim=-1).detach().numpy(), np.float32(surface.radius),
        edges.numpy(), views.numpy(),
    )  # fmt: skip
    return edges, views


@njit(cache=True, parallel=True, fastmath=True)
def _slide(
    root: np.ndarray,
    vectors: np.ndarray,
    rest_length: np.ndarray,
    margin: np.ndarray,
    leaves: np.ndarray,
    spheres: np.ndarray,
    radius: np.float32,
    edges: np.ndarray,
    views: np.ndarray,
) -> None:
    batch, strands, count, _ = vectors.shape
    tiny = np.float32(1e-24)
    for index in prange(batch * strands):
        sample, strand = index // strands, index % strands
        near, seen = np.empty((6, len(spheres[sample]) * LEAF), np.float32), 0
        x, y, z = root[sample, strand, 0], root[sample, strand, 1], root[sample, strand, 2]
        for edge in range(count):
            if edge % _STRIDE == 0:
                reach = np.float32(0.0)
                for ahead in range(edge, min(edge + _STRIDE, count)):
                    reach += rest_length[strand, ahead]
                seen = _gather(x, y, z, reach, leaves[sample], spheres[sample], near)
            length = rest_length[strand, edge]
            ux, uy, uz = (
                vectors[sample, strand, edge, 0],
                vectors[sample, strand, edge, 1],
                vectors[sample, strand, edge, 2],
            )
            scale = np.float32(1.0) / np.sqrt(ux * ux + uy * uy + uz * uz + tiny)
            ux, uy, uz = ux * scale, uy * scale, uz * scale
            view = views[sample, strand, edge]
            for _ in range(2):
                _look(x + length * ux, y + length * uy, z + length * uz, near, seen, radius, view)
                short = margin[strand, edge + 1] * view[4] - radius * view[0]
                if short <= np.float32(0.0):
                    break
                turn = short / length
                ux, uy, uz = ux + turn * view[1], uy + turn * view[2], uz + turn * view[3]
                scale = np.float32(1.0) / np.sqrt(ux * ux + uy * uy + uz * uz + tiny)
                ux, uy, uz = ux * scale, uy * scale, uz * scale
            x, y, z = x + length * ux, y + length * uy, z + length * uz
            edges[sample, strand, edge, 0] = ux
            edges[sample, strand, edge, 1] = uy
            edges[sample, strand, edge, 2] = uz


@njit(cache=True, fastmath=True, inline="always")
def _gather(
    x: float, y: float, z: float, way: np.float32, leaves: np.ndarray, spheres: np.ndarray, near: np.ndarray
) -> int:
    """Copy the points that may be seen on a way of this length [m] side by side; their number."""
    count = 0
    for leaf in range(len(spheres)):
        dx, dy, dz = x - spheres[leaf, 0], y - spheres[leaf, 1], z - spheres[leaf, 2]
        reach = way + spheres[leaf, 3]
        if dx * dx + dy * dy + dz * dz < reach * reach:
            for row in range(6):
                for k in range(LEAF):
                    near[row, count + k] = leaves[leaf, row, k]
            count += LEAF
    return count


@njit(cache=True, fastmath=True, inline="always")
def _look(px: float, py: float, pz: float, near: np.ndarray, seen: int, radius: np.float32, view: np.ndarray) -> None:
    one, none = np.float32(1.0), np.float32(0.0)
    per_square = one / (radius * radius)
    whole, height, mx, my, mz = none, none, none, none, none
    for k in range(seen):
        ox, oy, oz = px - near[0, k], py - near[1, k], pz - near[2, k]
        t = max(one - (ox * ox + oy * oy + oz * oz) * per_square, none)
        weight = t * t * t * t
        whole += weight
        height += weight * (ox * near[3, k] + oy * near[4, k] + oz * near[5, k])
        mx += weight * near[3, k]
        my += weight * near[4, k]
        mz += weight * near[5, k]
    scale = one / (whole + np.float32(_FAINT))
    view[0] = height * scale / radius
    view[1] = mx * scale
    view[2] = my * scale
    view[3] = mz * scale
    view[4] = whole * scale
