"""A smooth, approximate surface made of oriented points, and contact with it from root to tip.

A moving-least-squares surface (Shen et al. 2004) with weights of compact support: some hundred points stand for a
body, nothing has to be built when they move, and distances and normals change without jumps. It gives the network its
initial shape and its local features; energies and metrics use the exact surface
(`quaffure.geometry.signed_distance`).
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import njit, prange

from quaffure.backend import Backend, choose_backend
from quaffure.geometry.mls_kernels import (
    FAST,
    HEIGHT,
    LANES,
    LEAF,
    MIN_LENGTH,
    MIN_WEIGHT,
    NORMAL,
    POSITION,
    ROWS,
    UNROLL,
    WEIGHT,
    evaluate,
    list_points,
    normalize_features,
    record_points,
)
from quaffure.geometry.rotation import gibbs_vector, rotate_by_gibbs
from quaffure.types import EdgeVectors, Float, RestLengths, Tensor

LOCAL_FEATURES = 5
"""Numbers of a vertex: mean distance over the radius, mean normal, and share of weight (1 near the surface)."""


class MlsSurface(NamedTuple):
    """A batch of poses of one set of oriented points, in leaves of near neighbours.

    Attributes:
        points: positions [m].
        normals: unit, outwards.
        radius: support of a point's weight [m].
    """

    points: Float[Tensor, "b leaf 8 3"]
    normals: Float[Tensor, "b leaf 8 3"]
    radius: float


def local_features_reference(points: Float[Tensor, "b p 3"], surface: MlsSurface) -> Float[Tensor, "b p 5"]:
    """Torch twin of `local_features`."""
    offset = points[:, :, None] - surface.points.flatten(1, 2)[:, None]
    weight = (1 - offset.square().sum(-1) / surface.radius**2).clamp(min=0) ** 4
    normals = surface.normals.flatten(1, 2)
    height = (offset * normals[:, None]).sum(-1)
    whole = weight.sum(-1, keepdim=True)
    parts = [(weight * height).sum(-1, keepdim=True) / surface.radius, weight @ normals, whole]
    return torch.cat(parts, dim=-1) / (whole + MIN_WEIGHT)


def local_features(points: Float[Tensor, "b p 3"], surface: MlsSurface) -> Float[Tensor, "b p 5"]:
    """Features of the surface at positions near it; fastest where neighbours in the list are near each other.

    Returns:
        Mean signed distance over the radius, mean normal, and share of weight; all 0 far away.
    """
    if choose_backend(points) is Backend.TORCH:
        return local_features_reference(points, surface)
    batch, count = len(surface.points), LEAF * surface.points.shape[1]
    features = torch.empty(*points.shape[:2], LOCAL_FEATURES)
    records, scaled = np.zeros((batch, count + 1, 8), np.float32), np.empty((batch, 3, count), np.float32)
    positions, normals = surface.points.detach().flatten(1, 2), surface.normals.detach().flatten(1, 2)
    record_points(positions.numpy(), normals.numpy(), np.float32(1 / surface.radius), records, scaled)
    queries = (points.detach() / surface.radius).contiguous()
    _local_features(queries.numpy(), records, scaled, features.numpy())
    return features


def resolve_contact_reference(
    root: Float[Tensor, "b s 3"],
    vectors: EdgeVectors,
    rest_length: RestLengths,
    margin: Float[Tensor, "s n"],
    surface: MlsSurface,
    decay_length: float = 0.0,
) -> tuple[EdgeVectors, Float[Tensor, "b s e 5"]]:
    """Strands integrated edge by edge along `vectors`, each edge rotated out of the surface that its end would be in.

    Integrated from the root, a strand is never deep inside, so it always leaves on the side on which it came. The edges
    beyond follow a rotation, less and less: a rod bends over a length, it does not break at a vertex.

    Args:
        root: first vertices [m].
        vectors: edge directions without contact, of any length but zero.
        rest_length: of the edges [m].
        margin: distance that each vertex is to keep [m].
        decay_length: along a strand, over which edges return to their own directions after a contact [m].

    Returns:
        Unit edges, and the local features at the end of each before contact.
    """
    position, edges, features = root, [], []
    gibbs = torch.zeros_like(root)
    for edge in range(vectors.shape[2]):
        length = rest_length[:, edge, None].clamp(min=MIN_LENGTH)
        direction = rotate_by_gibbs(gibbs, torch.nn.functional.normalize(vectors[:, :, edge], dim=-1))
        feature = local_features_reference(position + length * direction, surface)
        depth = (margin[:, edge + 1, None] * feature[..., 4:] - surface.radius * feature[..., :1]).clamp(min=0)
        rotated = torch.nn.functional.normalize(direction + depth / length * feature[..., 1:4], dim=-1)
        gibbs = decay_length / (decay_length + length) * (gibbs + gibbs_vector(direction, rotated))
        direction = rotated
        position = position + length * direction
        edges.append(direction)
        features.append(feature)
    return torch.stack(edges, dim=2), torch.stack(features, dim=2)


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _local_features(queries: np.ndarray, records: np.ndarray, positions: np.ndarray, features: np.ndarray) -> None:
    batch, count = queries.shape[:2]
    blocks = (count + LANES - 1) // LANES
    for index in prange(batch * blocks):
        sample, first = index // blocks, (index % blocks) * LANES
        lanes, centre, farthest = np.empty(ROWS, np.float32), np.zeros(3, np.float32), np.float32(0.0)
        inside, near = np.empty(positions.shape[2], np.uint8), np.empty(records.shape[1] + UNROLL, np.uint32)
        for i in range(LANES):
            query = queries[sample, min(first + i, count - 1)]
            for axis in range(3):
                lanes[POSITION + axis * LANES + i] = query[axis]
                centre[axis] += query[axis] / np.float32(LANES)
        for i in range(LANES):
            dx, dy, dz = lanes[i] - centre[0], lanes[LANES + i] - centre[1], lanes[2 * LANES + i] - centre[2]
            farthest = max(farthest, np.sqrt(dx * dx + dy * dy + dz * dz))
        distance = np.float32(1.001) + farthest
        evaluate(records[sample], near, list_points(centre, distance, positions[sample], inside, near), lanes)
        normalize_features(lanes)
        for i in range(min(LANES, count - first)):
            feature = features[sample, first + i]
            feature[0], feature[4] = lanes[HEIGHT + i], lanes[WEIGHT + i]
            for axis in range(3):
                feature[1 + axis] = lanes[NORMAL + axis * LANES + i]
