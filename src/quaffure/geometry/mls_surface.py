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
from quaffure.geometry.rotation import gibbs_vector, rotate_by_gibbs
from quaffure.types import EdgeVectors, Float, RestLengths, Tensor

LEAF = 8
"""Points that are near each other and listed together."""
LOCAL_FEATURES = 5
"""Numbers of a vertex: mean distance over the radius, mean normal, and share of weight (1 near the surface)."""
MIN_WEIGHT = 0.02
"""Sum of weights at which features are halved: far from all points every channel fades to zero."""
MIN_LENGTH = 1e-12
"""Length that an edge is taken to have at least [m]."""
LANES = 16
"""Positions that are evaluated at once, one in each lane of the processor's vectors."""
# Rows of an evaluation, each of `LANES` numbers: position [radii], sum of weights, weighted sum of normals, weighted
# sum of the points' heights along their own normals.
POSITION, WEIGHT, NORMAL, HEIGHT = 0, 3 * LANES, 4 * LANES, 7 * LANES
ROWS = 8 * LANES
UNROLL = 2
"""Points whose sums stay in registers."""
_FAR = np.float32(1e9)  # position of the point that has no weight anywhere


FAST = {"contract", "nnan", "ninf", "nsz", "arcp"}
"""Fast arithmetic but for `reassoc`: a sum does not depend on where in the list its points stand."""


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


@njit(cache=True, error_model="numpy")
def record_points(
    positions: np.ndarray, normals: np.ndarray, per_radius: np.float32, records: np.ndarray, scaled: np.ndarray
) -> None:
    """Lay points out for `evaluate`, in units of their radius.

    Args:
        records: filled with a point's position, normal, height along its normal, and a zero; at the end with a point
            that has no weight anywhere.
        scaled: filled with x of all points, then y, then z.
    """
    for sample in range(len(positions)):
        for index in range(positions.shape[1]):
            for axis in range(3):
                position, normal = positions[sample, index, axis] * per_radius, normals[sample, index, axis]
                scaled[sample, axis, index] = position
                records[sample, index, axis] = position
                records[sample, index, 3 + axis] = normal
                records[sample, index, 6] += position * normal
        records[sample, -1] = _FAR


@njit(cache=True, fastmath=FAST, error_model="numpy")
def list_points(
    centre: np.ndarray, distance: np.float32, positions: np.ndarray, inside: np.ndarray, near: np.ndarray
) -> int:
    """List the points within a distance of a centre, then the one without weight up to a multiple of `UNROLL`.

    Args:
        inside: workspace, a byte a point.
        near: filled with indices.

    Returns:
        How many are listed.
    """
    count, listed = positions.shape[1], 0
    cx, cy, cz, square = centre[0], centre[1], centre[2], distance * distance
    for k in range(count):
        dx, dy, dz = positions[0, k] - cx, positions[1, k] - cy, positions[2, k] - cz
        inside[k] = dx * dx + dy * dy + dz * dz < square
    leaves = inside.view(np.uint64)
    for leaf in range(count // LEAF):
        if leaves[leaf] != 0:
            for k in range(leaf * LEAF, (leaf + 1) * LEAF):
                near[listed] = k  # kept by the count alone: cheaper than a branch that cannot be predicted
                listed += inside[k]
    while listed % UNROLL != 0:
        near[listed] = count
        listed += 1
    return listed


@njit(cache=True, fastmath=FAST, error_model="numpy")
def evaluate(records: np.ndarray, near: np.ndarray, listed: int, lanes: np.ndarray) -> None:
    """Weighted sums at `LANES` positions over the first `listed` points in `near`: fills the rows from `WEIGHT` on.

    Args:
        near: indices; `listed` is a multiple of `UNROLL`.
        lanes: a position in each lane of the rows from `POSITION` on.
    """
    none, one = np.float32(0.0), np.float32(1.0)
    for i in range(5 * LANES):
        lanes[WEIGHT + i] = none
    for first in range(0, listed, UNROLL):
        a, b = near[first], near[first + 1]
        # Read here, or the compiler has to make sure before every loop that no lane is part of a point.
        ax, ay, az, bx, by, bz = (
            records[a, 0],
            records[a, 1],
            records[a, 2],
            records[b, 0],
            records[b, 1],
            records[b, 2],
        )
        au, av, aw, bu, bv, bw = (
            records[a, 3],
            records[a, 4],
            records[a, 5],
            records[b, 3],
            records[b, 4],
            records[b, 5],
        )
        ah, bh = records[a, 6], records[b, 6]
        for i in range(LANES):
            x, y, z = lanes[POSITION + i], lanes[POSITION + LANES + i], lanes[POSITION + 2 * LANES + i]
            dx, dy, dz = x - ax, y - ay, z - az
            p = max(one - dx * dx - dy * dy - dz * dz, none)
            p *= p
            p *= p
            dx, dy, dz = x - bx, y - by, z - bz
            q = max(one - dx * dx - dy * dy - dz * dz, none)
            q *= q
            q *= q
            lanes[WEIGHT + i] = lanes[WEIGHT + i] + p + q
            lanes[NORMAL + i] = lanes[NORMAL + i] + p * au + q * bu
            lanes[NORMAL + LANES + i] = lanes[NORMAL + LANES + i] + p * av + q * bv
            lanes[NORMAL + 2 * LANES + i] = lanes[NORMAL + 2 * LANES + i] + p * aw + q * bw
            lanes[HEIGHT + i] = lanes[HEIGHT + i] + p * ah + q * bh


@njit(cache=True, fastmath=FAST, error_model="numpy")
def normalize_features(lanes: np.ndarray) -> None:
    """Means of the sums of `evaluate`: `HEIGHT` is then above the surface, `WEIGHT` the share of weight."""
    for i in range(LANES):
        whole = lanes[WEIGHT + i]
        scale = np.float32(1.0) / (whole + np.float32(MIN_WEIGHT))
        mx, my, mz = lanes[NORMAL + i], lanes[NORMAL + LANES + i], lanes[NORMAL + 2 * LANES + i]
        x, y, z = lanes[POSITION + i], lanes[POSITION + LANES + i], lanes[POSITION + 2 * LANES + i]
        lanes[HEIGHT + i] = (x * mx + y * my + z * mz - lanes[HEIGHT + i]) * scale
        lanes[WEIGHT + i] = whole * scale
        lanes[NORMAL + i], lanes[NORMAL + LANES + i], lanes[NORMAL + 2 * LANES + i] = mx * scale, my * scale, mz * scale


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
