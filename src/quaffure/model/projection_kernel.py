"""Compiled part of `quaffure.model.projection`."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import get_num_threads, njit, prange

from quaffure.geometry.mls_kernels import FAST
from quaffure.geometry.rotation_kernel import Vector, lifted_edge
from quaffure.geometry.triangle_grid import OUT_OF_BAND, TriangleGrid, nearest_triangle_in_band, triangle_grid
from quaffure.model.bend_relaxation_kernel import bend_before, eliminated, turned

_PADDING = 64  # numbers between the workspaces of threads, which would write into one line of the cache
# Columns of the workspace of an edge: direction, bend, and theta_i = follows theta_(i-1) - shift.
_DIRECTION, _BEND, _SHIFT, _FOLLOWS, _COLUMNS = 0, 3, 6, 9, 10
LEAST_RELAXED = 1e-4
"""Largest displacement of a vertex by a relaxation up to which its strand is not pushed again [m]."""
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


class PushedRods(NamedTuple):
    """Strands of a groom at rest, as the projection reads them.

    Attributes:
        rest_length: of every edge [m].
        clearance: distance from the skin that each vertex is to keep [m], not above the band of the skin.
        bending: B of each joint [m^2], see `quaffure.model.prepared_groom.DesignRods`.
        goal: stiffness of what holds an edge to the posed design [m^2].
    """

    rest_length: Float[np.ndarray, "s e"]
    clearance: Float[np.ndarray, "s n"]
    bending: Float[np.ndarray, "s e"]
    goal: Float[np.ndarray, "s e"]


class PushSettings(NamedTuple):
    """Fields of `quaffure.model.network_config.ProjectionConfig`, the cosine between an edge and the normal that its
    `max_push` is at most, and the stiffness of all joints."""

    pushes: int
    spacing: np.float32
    most_rise: np.float32
    push_relaxation: np.float32
    contact_stiffness: np.float32
    stiffness: np.float32


def push_out(
    hair: Float[np.ndarray, "s n 3"],
    rods: PushedRods,
    settings: PushSettings,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "k 3"],
    band: Float[np.ndarray, "k 2"],
    centre: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "s n 3"]:
    """Strands projected out of the skin [m], see `quaffure.model.projection.project`; all positions are finite."""
    out, threads, edges = np.empty_like(hair), get_num_threads(), rods.rest_length.shape[1]
    body, rows = (vertices, faces, band, centre), np.empty((threads, _PADDING), np.float32)
    spaces = np.empty((threads, edges * _COLUMNS + _PADDING), np.float32)
    if not _push_out(hair, rods, settings, triangle_grid(*body, hair.reshape(-1, 3)), rows, spaces, out):
        _push_out(hair, rods, settings, triangle_grid(*body), rows, spaces, out)
    return out


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _push_out(
    hair: np.ndarray, rods: PushedRods, settings: PushSettings, grid: TriangleGrid, rows: np.ndarray,
    spaces: np.ndarray, out: np.ndarray,
) -> bool:  # fmt: skip
    """Fill `out`; False where a push has moved hair to where the grid lists no faces."""
    threads = len(rows)
    listed = np.ones(threads, np.uint8)
    for thread in prange(threads):
        for strand in range(thread, len(hair), threads):
            result = out[strand]
            result[:] = hair[strand]
            for _ in range(settings.pushes):
                pushed, in_grid = _sweep(rods, strand, settings, grid, rows[thread], result)
                if not in_grid:
                    listed[thread] = 0
                if not (pushed and settings.push_relaxation > _ZERO):
                    break
                relaxed = _relax(hair[strand], rods, strand, settings, spaces[thread], result)
                if relaxed < np.float32(LEAST_RELAXED * LEAST_RELAXED):
                    break
    return listed.min() == 1


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _sweep(
    rods: PushedRods, strand: int, settings: PushSettings, grid: TriangleGrid, row: np.ndarray, hair: np.ndarray
) -> tuple[bool, bool]:
    """Push a strand [n 3] out of the skin from the root to the tip.

    Returns:
        Whether it was pushed, and whether the grid listed the faces at all of its vertices.
    """
    last, free, dx, dy, dz = len(hair) - 1, _ZERO, _ZERO, _ZERO, _ZERO
    pushed, in_grid = False, True
    for vertex in range(1, last + 1):
        x, y, z = hair[vertex, 0] + dx, hair[vertex, 1] + dy, hair[vertex, 2] + dz
        length = rods.rest_length[strand, vertex - 1]
        free -= length
        if free < _ZERO or vertex == last:
            free = settings.spacing - _HALF * length
            height, face = nearest_triangle_in_band(x, y, z, grid, row)
            if face == OUT_OF_BAND:
                in_grid = False
            push = rods.clearance[strand, vertex] - height
            if face >= 0 and push > _ZERO:
                pushed = True
                px, py, pz = hair[vertex - 1, 0], hair[vertex - 1, 1], hair[vertex - 1, 2]
                record = grid.records[face]
                normal = record[0], record[1], record[2]
                ux, uy, uz = lifted_edge((x - px, y - py, z - pz), normal, push, length, settings.most_rise)
                ux, uy, uz = px + ux, py + uy, pz + uz
                dx, dy, dz = dx + ux - x, dy + uy - y, dz + uz - z
                x, y, z = ux, uy, uz
        hair[vertex, 0], hair[vertex, 1], hair[vertex, 2] = x, y, z
    return pushed, in_grid


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _relax(
    unpushed: np.ndarray, rods: PushedRods, strand: int, settings: PushSettings, memory: np.ndarray, hair: np.ndarray
) -> np.floating:
    """Relax the bends of a pushed strand [n 3] relative to the one that came (`quaffure.model.bend_relaxation`).

    Returns:
        Largest squared displacement of a vertex [m^2].
    """
    edges = rods.rest_length.shape[1]
    space = memory[: edges * _COLUMNS].reshape(edges, _COLUMNS)
    rotation = _ONE, _ZERO, _ZERO, _ZERO
    for edge in range(edges):
        direction = _direction(hair, edge)
        bend, rotation = bend_before(rotation, _direction(unpushed, edge), direction)
        space[edge, _DIRECTION], space[edge, _DIRECTION + 1], space[edge, _DIRECTION + 2] = direction
        space[edge, _BEND], space[edge, _BEND + 1], space[edge, _BEND + 2] = bend
    stiffness, slope, per_relaxation = _ZERO, (_ZERO, _ZERO, _ZERO), _ONE / settings.push_relaxation
    for edge in range(edges - 1, -1, -1):
        joint, length = settings.stiffness * rods.bending[strand, edge], rods.rest_length[strand, edge]
        resistance = max(joint * per_relaxation, settings.contact_stiffness * length * length)
        stiffness += resistance + rods.goal[strand, edge]
        bend = space[edge, _BEND], space[edge, _BEND + 1], space[edge, _BEND + 2]
        follows, shift, slope = eliminated(bend, slope, joint, stiffness)
        stiffness *= follows
        space[edge, _FOLLOWS] = follows
        space[edge, _SHIFT], space[edge, _SHIFT + 1], space[edge, _SHIFT + 2] = shift
    theta, x, y, z, farthest = (_ZERO, _ZERO, _ZERO), hair[0, 0], hair[0, 1], hair[0, 2], _ZERO
    for edge in range(edges):
        direction = space[edge, _DIRECTION], space[edge, _DIRECTION + 1], space[edge, _DIRECTION + 2]
        shift = space[edge, _SHIFT], space[edge, _SHIFT + 1], space[edge, _SHIFT + 2]
        theta, direction = turned(space[edge, _FOLLOWS], shift, theta, direction)
        length = rods.rest_length[strand, edge]
        x, y, z = x + length * direction[0], y + length * direction[1], z + length * direction[2]
        dx, dy, dz = x - hair[edge + 1, 0], y - hair[edge + 1, 1], z - hair[edge + 1, 2]
        farthest = max(farthest, dx * dx + dy * dy + dz * dz)
        hair[edge + 1, 0], hair[edge + 1, 1], hair[edge + 1, 2] = x, y, z
    return farthest


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _direction(hair: np.ndarray, edge: int) -> Vector:
    x, y, z = (
        hair[edge + 1, 0] - hair[edge, 0],
        hair[edge + 1, 1] - hair[edge, 1],
        hair[edge + 1, 2] - hair[edge, 2],
    )
    scale = _ONE / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
    return scale * x, scale * y, scale * z
