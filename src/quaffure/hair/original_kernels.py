"""Kernels of `quaffure.hair.source_strands`: rotations along guides, and strands that follow them."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.geometry.bvh import search_workspace
from quaffure.geometry.surface import SurfaceArrays
from quaffure.geometry.surface_distance import distance_within
from quaffure.hair.clearance import CAUGHT_FOLDS

CLEARANCE = np.float32(1.5e-3)
"""Distance that strands keep from the skin [m]."""
CLEARANCE_RAMP = np.float32(0.25)  # increase of it per length of strand from the root, which lies on the skin
CONTACT_PASSES = 4
RETURN = np.float32(0.03)
"""Length of strand in which it returns to its course by a factor of e after a contact [m]."""
LARGEST_TURN = np.float32(0.7)  # of an edge on the way back, as the tangent of the angle
LEAST_COSINE = np.float32(0.3)  # of an edge of such a strand and its course
_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_LEAST = np.float32(1e-12)
_FAR = np.float32(1e6)
_OPPOSITE = np.float32(1e-6)  # 1 + cosine of two directions that no shortest arc connects


class DrivenStrands(NamedTuple):
    """Fields of `OriginalStrands`, as the kernel reads them."""

    points: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    guides: np.ndarray
    weights: np.ndarray
    own_guide: np.ndarray
    edge_length: np.ndarray


@njit(cache=True, parallel=True, fastmath=True)
def guide_rotations(rest: np.ndarray, draped: np.ndarray, root: np.ndarray, rotations: np.ndarray) -> None:
    """Rotation of every edge of every guide from rest to the drape [g, e, 3, 3], without twist along the guide.

    Args:
        root: rotation of the root's face [g, 3, 3]; each edge's rotation is that of the edge before it, followed by the
            shortest arc to its own direction.
    """
    for guide in prange(len(rest)):
        turn = root[guide].copy()
        a, b, column = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(3, np.float32)
        for edge in range(rest.shape[1] - 1):
            _unit_edge(rest[guide], edge, column)
            for i in range(3):
                a[i] = turn[i, 0] * column[0] + turn[i, 1] * column[1] + turn[i, 2] * column[2]
            _unit_edge(draped[guide], edge, b)
            vx, vy, vz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
            scale = _ONE / max(_ONE + a[0] * b[0] + a[1] * b[1] + a[2] * b[2], _OPPOSITE)
            for j in range(3):
                x, y, z = turn[0, j], turn[1, j], turn[2, j]
                cx, cy, cz = vy * z - vz * y, vz * x - vx * z, vx * y - vy * x
                turn[0, j] = x + cx + scale * (vy * cz - vz * cy)
                turn[1, j] = y + cy + scale * (vz * cx - vx * cz)
                turn[2, j] = z + cz + scale * (vx * cy - vy * cx)
            rotations[guide, edge] = turn


@njit(cache=True, parallel=True, fastmath=True)
def drive_strands(
    strands: DrivenStrands,
    draped: np.ndarray,
    rotations: np.ndarray,
    roots: np.ndarray,
    root_rotations: np.ndarray,
    body: SurfaceArrays,
    out: np.ndarray,
) -> None:
    """Vertices of all strands of a frame [p, 3], roots first, out of the body.

    Args:
        draped: guides [g, n, 3] [m, world].
        rotations: of `guide_rotations`.
        roots, root_rotations: position and rotation from rest of every strand's root.
        body: of one pose.
    """
    for strand in prange(len(strands.counts)):
        first, count = strands.starts[strand], strands.counts[strand]
        out[first] = roots[strand]
        own = strands.own_guide[strand]
        if own >= 0:
            _copy_guide(strands.points[first : first + count], draped[own], out[first : first + count])
            continue
        _follow(strand, strands, rotations, root_rotations[strand], out)
        if strands.weights[strand, 0] > _ZERO:
            _leave_body(out[first : first + count], body)


@njit(cache=True, fastmath=True)
def _unit_edge(strand: np.ndarray, edge: int, out: np.ndarray) -> float:
    total = _ZERO
    for axis in range(3):
        out[axis] = strand[edge + 1, axis] - strand[edge, axis]
        total += out[axis] * out[axis]
    length = np.sqrt(max(total, _LEAST * _LEAST))
    for axis in range(3):
        out[axis] /= length
    return length


@njit(cache=True, fastmath=True)
def _copy_guide(rest: np.ndarray, draped: np.ndarray, out: np.ndarray) -> None:
    """Points along a draped guide at the arc lengths of the strand's own, as shares of the whole."""
    step = np.empty(3, np.float32)
    total = _ZERO
    for edge in range(len(rest) - 1):
        total += _unit_edge(rest, edge, step)
    along = _ZERO
    edges = len(draped) - 1
    for vertex in range(len(rest)):
        if vertex > 0:
            along += _unit_edge(rest, vertex - 1, step)
        place = along / max(total, _LEAST) * np.float32(edges)
        edge = min(int(place), edges - 1)
        share = place - np.float32(edge)
        for axis in range(3):
            out[vertex, axis] = draped[edge, axis] + share * (draped[edge + 1, axis] - draped[edge, axis])


@njit(cache=True, fastmath=True)
def _follow(
    strand: int, strands: DrivenStrands, rotations: np.ndarray, root_rotation: np.ndarray, out: np.ndarray
) -> None:
    """Edges turned as those of the guides are at the same arc length; integrated from the root with their lengths."""
    first, count = strands.starts[strand], strands.counts[strand]
    edge_count = rotations.shape[1]
    unit, turned, one = np.empty(3, np.float32), np.empty(3, np.float32), np.empty((3, 3), np.float32)
    along = _ZERO
    for vertex in range(first, first + count - 1):
        length = _unit_edge(strands.points, vertex, unit)
        turned[:] = _ZERO
        if strands.weights[strand, 0] == _ZERO:
            _turn(root_rotation, unit, _ONE, turned)
        for k in range(3):
            weight = strands.weights[strand, k]
            if weight == _ZERO:
                continue
            guide = strands.guides[strand, k]
            place = (along + _HALF * length) / strands.edge_length[guide] - _HALF
            place = min(max(place, _ZERO), np.float32(edge_count - 1))
            edge = min(int(place), edge_count - 2)
            share = place - np.float32(edge)
            one[k] = _ZERO
            _turn(rotations[guide, edge], unit, _ONE - share, one[k])
            _turn(rotations[guide, edge + 1], unit, share, one[k])
            if k > 0:  # guides that part from the nearest one, at a shoulder, are left
                agreement = max(one[0, 0] * one[k, 0] + one[0, 1] * one[k, 1] + one[0, 2] * one[k, 2], _ZERO)
                weight *= agreement * agreement
            for axis in range(3):
                turned[axis] += weight * one[k, axis]
        norm = np.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2] + _LEAST)
        for axis in range(3):
            out[vertex + 1, axis] = out[vertex, axis] + length / norm * turned[axis]
        along += length


@njit(cache=True, fastmath=True, inline="always")
def _turn(matrix: np.ndarray, vector: np.ndarray, weight: float, out: np.ndarray) -> None:
    for i in range(3):
        out[i] += weight * (matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2])


@njit(cache=True)
def _leave_body(strand: np.ndarray, body: SurfaceArrays) -> None:
    """Push vertices out from root to tip; edges keep their lengths, and after a contact the strand returns to its own
    course. One that would get caught, as above an ear through which it leads, is turned less, and stays inside."""
    course = strand.copy()
    if _push_out(course, -_ONE, body, strand) >= CAUGHT_FOLDS:
        _push_out(course, LEAST_COSINE, body, strand)


@njit(cache=True)
def _push_out(course: np.ndarray, least: float, body: SurfaceArrays, out: np.ndarray) -> int:
    """Write a strand that is out of the body. Returns how often it folds back where its course does not.

    Args:
        course: the strand without contact.
        least: cosine of the largest angle between an edge and its course.
    """
    workspace = search_workspace()
    edge, shift, at = np.empty(3, np.float32), np.zeros(3, np.float32), np.empty(3, np.float32)
    along, leaf, folds = _ZERO, 0, 0
    for vertex in range(1, len(course)):
        for axis in range(3):
            edge[axis] = course[vertex, axis] - course[vertex - 1, axis]
        length = np.sqrt(_squared(edge))
        along += length
        needed = min(CLEARANCE_RAMP * along, CLEARANCE)
        # Less than a right angle, so that no shift folds the strand.
        share = length / max(RETURN + length, np.sqrt(_squared(shift)) / LARGEST_TURN)
        for axis in range(3):
            at[axis] = out[vertex - 1, axis] + edge[axis] - share * shift[axis]
        _at_length(out[vertex - 1], length, at)
        for _ in range(CONTACT_PASSES):
            if not abs(at[0]) + abs(at[1]) + abs(at[2]) < _FAR:  # a NaN has no cell in the grid
                return 0
            distance, nx, ny, nz, face = distance_within(at[0], at[1], at[2], needed, leaf, body, workspace)
            leaf = face if face >= 0 else leaf
            if distance >= needed:
                break
            push = needed - distance
            at[0] += push * nx
            at[1] += push * ny
            at[2] += push * nz
            _at_length(out[vertex - 1], length, at)
        if least > -_ONE:
            _turn_towards(edge, out[vertex - 1], least, at)
        for axis in range(3):
            shift[axis] = at[axis] - course[vertex, axis]
            out[vertex, axis] = at[axis]
        if vertex > 1 and _cosine(out, vertex) < _ZERO and _cosine(course, vertex) > _HALF:
            folds += 1
    return folds


@njit(cache=True, fastmath=True)
def _turn_towards(edge: np.ndarray, start: np.ndarray, least: float, end: np.ndarray) -> None:
    """Turn what leads from `start` to `end` towards an edge of the same length, until the cosine between them is
    `least`."""
    squared, along = _squared(edge), _ZERO
    for axis in range(3):
        along += (end[axis] - start[axis]) * edge[axis]
    if squared <= _LEAST or along >= least * squared:
        return
    across = np.empty(3, np.float32)
    for axis in range(3):
        across[axis] = end[axis] - start[axis] - along / squared * edge[axis]
    scale = np.sqrt((_ONE - least * least) * squared / (_squared(across) + _LEAST))
    for axis in range(3):
        end[axis] = start[axis] + least * edge[axis] + scale * across[axis]


@njit(cache=True, fastmath=True)
def _cosine(strand: np.ndarray, vertex: int) -> float:
    """Cosine of the angle between the edge that ends at a vertex and the one before."""
    product, before, after = _ZERO, _LEAST, _LEAST
    for axis in range(3):
        first = strand[vertex - 1, axis] - strand[vertex - 2, axis]
        second = strand[vertex, axis] - strand[vertex - 1, axis]
        product += first * second
        before += first * first
        after += second * second
    return product / np.sqrt(before * after)


@njit(cache=True, fastmath=True, inline="always")
def _squared(vector: np.ndarray) -> float:
    return vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]


@njit(cache=True, fastmath=True, inline="always")
def _at_length(start: np.ndarray, length: float, end: np.ndarray) -> None:
    """Move the end of an edge along it."""
    x, y, z = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    scale = length / np.sqrt(x * x + y * y + z * z + _LEAST)
    end[0], end[1], end[2] = start[0] + scale * x, start[1] + scale * y, start[2] + scale * z
