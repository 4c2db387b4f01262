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
"""Points that are near each other and listed together."""
LOCAL_FEATURES = 5
"""What a vertex sees: mean distance over the radius, mean normal, and how much there is to see."""
MIN_WEIGHT = 0.02
"""Sum of weights at which a view counts half: far from all points every channel fades to zero."""
SHORTEST = 1e-12
"""Length that an edge is taken to have at least [m]."""
LANES = 16
"""Places that look at once."""
# Rows of a look, each of `LANES` numbers: place [radii], and what is seen: sum of weights, weighted sum of normals,
# weighted sum of the points' heights along their own normals.
PLACE, WEIGHT, NORMAL, HEIGHT = 0, 3 * LANES, 4 * LANES, 7 * LANES
LOOK_SIZE = 8 * LANES
AT_ONCE = 2
"""Points whose sums stay in registers."""
_NOWHERE = np.float32(1e9)  # where the point is that weighs nothing anywhere


FAST = {"contract", "nnan", "ninf", "nsz", "arcp"}
"""Fast arithmetic but for `reassoc`: a sum does not depend on where in the list its points stand."""


class MlsSurface(NamedTuple):
    """A batch of poses of one set of oriented points, in leaves of near neighbours.

    Attributes:
        points: positions [m].
        normals: unit, outwards.
        radius: reach of a point [m].
    """

    points: Float[Tensor, "b leaf 8 3"]
    normals: Float[Tensor, "b leaf 8 3"]
    radius: float


def local_features_reference(points: Float[Tensor, "b p 3"], surface: MlsSurface) -> Float[Tensor, "b p 5"]:
    """What oriented points of a surface say of places near it: the torch twin of `local_features`.

    Returns:
        Mean signed distance over the radius, mean normal, and how much there is to see; all 0 far away.
    """
    offset = points[:, :, None] - surface.points.flatten(1, 2)[:, None]
    weight = (1 - offset.square().sum(-1) / surface.radius**2).clamp(min=0) ** 4
    normals = surface.normals.flatten(1, 2)
    height = (offset * normals[:, None]).sum(-1)
    whole = weight.sum(-1, keepdim=True)
    parts = [(weight * height).sum(-1, keepdim=True) / surface.radius, weight @ normals, whole]
    return torch.cat(parts, dim=-1) / (whole + MIN_WEIGHT)


def local_features(points: Float[Tensor, "b p 3"], surface: MlsSurface) -> Float[Tensor, "b p 5"]:
    """What oriented points of a surface say of places near it; fastest where neighbours in the list are near.

    Returns:
        Mean signed distance over the radius, mean normal, and how much there is to see; all 0 far away.
    """
    if points.device.type != "cpu" or points.dtype != torch.float32:
        return local_features_reference(points, surface)
    views, records = torch.empty(*points.shape[:2], LOCAL_FEATURES), mls_points(surface)
    scaled = (points.detach() / surface.radius).contiguous()
    _views(scaled.numpy(), *records, views.numpy())
    return views


def resolve_contact_reference(
    root: Float[Tensor, "b s 3"],
    vectors: EdgeVectors,
    rest_length: RestLengths,
    margin: Float[Tensor, "s n"],
    surface: MlsSurface,
) -> tuple[EdgeVectors, Float[Tensor, "b s e 5"]]:
    """Strands grown edge by edge along `vectors`, each edge turned out of the surface that its end would be in.

    Growing from the root, a strand is never deep inside, so it always leaves on the side on which it came.

    Args:
        root: where strands begin [m].
        vectors: where their edges would point, of any length but zero.
        rest_length: of the edges [m].
        margin: distance that each vertex is to keep [m].

    Returns:
        Unit edges, and what the end of each saw of the surface before it turned.
    """
    place, edges, views = root, [], []
    for edge in range(vectors.shape[2]):
        length = rest_length[:, edge, None].clamp(min=SHORTEST)
        direction = torch.nn.functional.normalize(vectors[:, :, edge], dim=-1)
        view = local_features_reference(place + length * direction, surface)
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


class MlsPoints(NamedTuple):
    """A `MlsSurface` as `look` reads it, lengths in units of its radius.

    Attributes:
        points: a point's position, normal, height along its normal, and a zero; leaf after leaf, and at the end a
            point that weighs nothing anywhere.
        places: x of all points but the last, then y, then z.
    """

    points: Float[np.ndarray, "b p 8"]
    places: Float[np.ndarray, "b 3 q"]


def mls_points(surface: MlsSurface) -> MlsPoints:
    """Lay a surface out for `look`; float32, on the CPU."""
    batch, count = len(surface.points), LEAF * surface.points.shape[1]
    records = MlsPoints(np.zeros((batch, count + 1, 8), np.float32), np.empty((batch, 3, count), np.float32))
    positions, normals = surface.points.detach().flatten(1, 2), surface.normals.detach().flatten(1, 2)
    _record(positions.numpy(), normals.numpy(), np.float32(1 / surface.radius), *records)
    return records


@njit(cache=True, error_model="numpy")
def _record(
    positions: np.ndarray, normals: np.ndarray, per_radius: np.float32, points: np.ndarray, places: np.ndarray
) -> None:
    for sample in range(len(positions)):
        for index in range(positions.shape[1]):
            for axis in range(3):
                place, normal = positions[sample, index, axis] * per_radius, normals[sample, index, axis]
                places[sample, axis, index] = place
                points[sample, index, axis] = place
                points[sample, index, 3 + axis] = normal
                points[sample, index, 6] += place * normal
        points[sample, -1] = _NOWHERE


@njit(cache=True, fastmath=FAST, error_model="numpy")
def list_near(centre: np.ndarray, reach: np.float32, places: np.ndarray, inside: np.ndarray, near: np.ndarray) -> int:
    """List the points within `reach` of a centre, then the one that weighs nothing up to a multiple of `AT_ONCE`.

    Args:
        inside: room for a byte a point.
        near: filled with indices.

    Returns:
        How many are listed.
    """
    count, listed = places.shape[1], 0
    cx, cy, cz, square = centre[0], centre[1], centre[2], reach * reach
    for k in range(count):
        dx, dy, dz = places[0, k] - cx, places[1, k] - cy, places[2, k] - cz
        inside[k] = dx * dx + dy * dy + dz * dz < square
    leaves = inside.view(np.uint64)
    for leaf in range(count // LEAF):
        if leaves[leaf] != 0:
            for k in range(leaf * LEAF, (leaf + 1) * LEAF):
                near[listed] = k  # kept by the count alone: cheaper than a branch that cannot be foretold
                listed += inside[k]
    while listed % AT_ONCE != 0:
        near[listed] = count
        listed += 1
    return listed


@njit(cache=True, fastmath=FAST, error_model="numpy")
def look(points: np.ndarray, near: np.ndarray, listed: int, lanes: np.ndarray) -> None:
    """Sum up what `LANES` places see of the first `listed` points in `near`: fills the rows from `WEIGHT` on.

    Args:
        near: indices; `listed` is a multiple of `AT_ONCE`.
        lanes: a place in each lane of the rows from `PLACE` on.
    """
    none, one = np.float32(0.0), np.float32(1.0)
    for i in range(5 * LANES):
        lanes[WEIGHT + i] = none
    for first in range(0, listed, AT_ONCE):
        a, b = near[first], near[first + 1]
        # Read here, or the compiler has to make sure before every loop that no lane is part of a point.
        ax, ay, az, bx, by, bz = points[a, 0], points[a, 1], points[a, 2], points[b, 0], points[b, 1], points[b, 2]
        au, av, aw, bu, bv, bw = points[a, 3], points[a, 4], points[a, 5], points[b, 3], points[b, 4], points[b, 5]
        ah, bh = points[a, 6], points[b, 6]
        for i in range(LANES):
            x, y, z = lanes[PLACE + i], lanes[PLACE + LANES + i], lanes[PLACE + 2 * LANES + i]
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
    """Make means of what `look` has summed up: `HEIGHT` is then above the surface, `WEIGHT` how much is to be seen."""
    for i in range(LANES):
        whole = lanes[WEIGHT + i]
        scale = np.float32(1.0) / (whole + np.float32(MIN_WEIGHT))
        mx, my, mz = lanes[NORMAL + i], lanes[NORMAL + LANES + i], lanes[NORMAL + 2 * LANES + i]
        x, y, z = lanes[PLACE + i], lanes[PLACE + LANES + i], lanes[PLACE + 2 * LANES + i]
        lanes[HEIGHT + i] = (x * mx + y * my + z * mz - lanes[HEIGHT + i]) * scale
        lanes[WEIGHT + i] = whole * scale
        lanes[NORMAL + i], lanes[NORMAL + LANES + i], lanes[NORMAL + 2 * LANES + i] = mx * scale, my * scale, mz * scale


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _views(seers: np.ndarray, points: np.ndarray, places: np.ndarray, views: np.ndarray) -> None:
    batch, count = seers.shape[:2]
    runs = (count + LANES - 1) // LANES
    for index in prange(batch * runs):
        sample, first = index // runs, (index % runs) * LANES
        lanes, centre, farthest = np.empty(LOOK_SIZE, np.float32), np.zeros(3, np.float32), np.float32(0.0)
        inside, near = np.empty(places.shape[2], np.uint8), np.empty(points.shape[1] + AT_ONCE, np.uint32)
        for i in range(LANES):
            place = seers[sample, min(first + i, count - 1)]
            for axis in range(3):
                lanes[PLACE + axis * LANES + i] = place[axis]
                centre[axis] += place[axis] / np.float32(LANES)
        for i in range(LANES):
            dx, dy, dz = lanes[i] - centre[0], lanes[LANES + i] - centre[1], lanes[2 * LANES + i] - centre[2]
            farthest = max(farthest, np.sqrt(dx * dx + dy * dy + dz * dz))
        reach = np.float32(1.001) + farthest
        look(points[sample], near, list_near(centre, reach, places[sample], inside, near), lanes)
        normalize_features(lanes)
        for i in range(min(LANES, count - first)):
            view = views[sample, first + i]
            view[0], view[4] = lanes[HEIGHT + i], lanes[WEIGHT + i]
            for axis in range(3):
                view[1 + axis] = lanes[NORMAL + axis * LANES + i]
