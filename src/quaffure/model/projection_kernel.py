"""Compiled part of `quaffure.model.projection`."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import get_num_threads, njit, prange

from quaffure.geometry.mls_kernels import FAST
from quaffure.geometry.rotation_kernel import pushed_edge
from quaffure.geometry.triangle_grid import OUT_OF_BAND, TriangleGrid, nearest_triangle_in_band, triangle_grid

_PADDING = 64  # numbers between the workspaces of threads, which would write into one line of the cache


class ProjectedStrands(NamedTuple):
    """Arguments of `quaffure.model.projection.project`, and fields of its configuration."""

    positions: np.ndarray
    rest_length: np.ndarray
    clearance: np.ndarray
    spacing: np.float32
    max_push: np.float32


def push_out(
    strands: ProjectedStrands,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "k 3"],
    band: Float[np.ndarray, "k 2"],
    centre: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "s n 3"]:
    """The strands projected out of the skin [m]; positions are finite."""
    out = np.empty_like(strands.positions)
    body, rows = (vertices, faces, band, centre), np.empty((get_num_threads(), _PADDING), np.float32)
    if not _push_out(strands, triangle_grid(*body, strands.positions.reshape(-1, 3)), rows, out):
        _push_out(strands, triangle_grid(*body), rows, out)
    return out


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _push_out(strands: ProjectedStrands, grid: TriangleGrid, rows: np.ndarray, out: np.ndarray) -> bool:
    """Fill `out`; False where a push has moved hair to where the grid lists no faces."""
    threads, none, last = len(rows), np.float32(0.0), strands.positions.shape[1] - 1
    listed = np.ones(threads, np.uint8)
    for thread in prange(threads):
        for strand in range(thread, len(strands.positions), threads):
            own, result, free, dx, dy, dz = strands.positions[strand], out[strand], none, none, none, none
            result[0, 0], result[0, 1], result[0, 2] = own[0, 0], own[0, 1], own[0, 2]
            for vertex in range(1, last + 1):
                x, y, z = own[vertex, 0] + dx, own[vertex, 1] + dy, own[vertex, 2] + dz
                length = strands.rest_length[strand, vertex - 1]
                free -= length
                if free < none or vertex == last:
                    free = strands.spacing - np.float32(0.5) * length
                    height, face = nearest_triangle_in_band(x, y, z, grid, rows[thread])
                    if face == OUT_OF_BAND:
                        listed[thread] = 0
                    push = min(strands.clearance[strand, vertex] - height, strands.max_push * length)
                    if face >= 0 and push > none:
                        px, py, pz = result[vertex - 1, 0], result[vertex - 1, 1], result[vertex - 1, 2]
                        record = grid.records[face]
                        normal = record[0], record[1], record[2]
                        ux, uy, uz = pushed_edge((px, py, pz), (x, y, z), normal, push, length)
                        ux, uy, uz = px + ux, py + uy, pz + uz
                        dx, dy, dz = dx + ux - x, dy + uy - y, dz + uz - z
                        x, y, z = ux, uy, uz
                result[vertex, 0], result[vertex, 1], result[vertex, 2] = x, y, z
    return listed.min() == 1
