"""Compiled integration of edges that the network has rotated."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.geometry.mls_kernels import FAST
from quaffure.geometry.rotation_kernel import rotated_by_gibbs


class ShapeRows(NamedTuple):
    """Rows of a `quaffure.model.initial_shape.InitialShape`, and the strand of each."""

    roots: np.ndarray
    edges: np.ndarray
    compliance: np.ndarray
    strand: np.ndarray


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def integrate_edges(
    shape: ShapeRows, changes: np.ndarray, rest_length: np.ndarray, world_from_head: np.ndarray, head: np.ndarray,
    threads: int,
) -> np.ndarray:  # fmt: skip
    """Vertices [strand, vertex, 3] [m, world] of edges rotated by the sum of the network's outputs before them, in the
    order of `rest_length` [strand, edge].

    Args:
        changes: of each row, the bits of float32, or of bfloat16.
    """
    edges, compliance = shape.edges, shape.compliance
    count, columns = edges.shape[1], changes.shape[1]
    hair = np.empty((len(rest_length), count + 1, 3), np.float32)
    spaces, shift = np.empty((threads, columns), np.uint32), np.uint32(32 - 8 * changes.itemsize)
    a, b, c = world_from_head[0], world_from_head[1], world_from_head[2]
    for thread in prange(threads):
        bits, change = spaces[thread], spaces[thread].view(np.float32)
        for row in range(thread, len(rest_length), threads):  # the rows after these repeat the last strand
            for k in range(columns):
                bits[k] = np.uint32(changes[row, k]) << shift
            own, x, y, z = shape.strand[row], shape.roots[row, 0], shape.roots[row, 1], shape.roots[row, 2]
            p, q, r = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for vertex in range(count + 1):
                hair[own, vertex, 0] = head[0] + a[0] * x + a[1] * y + a[2] * z
                hair[own, vertex, 1] = head[1] + b[0] * x + b[1] * y + b[2] * z
                hair[own, vertex, 2] = head[2] + c[0] * x + c[1] * y + c[2] * z
                if vertex < count:
                    half = np.float32(0.5) * compliance[row, vertex]
                    p += half * change[3 * vertex]
                    q += half * change[3 * vertex + 1]
                    r += half * change[3 * vertex + 2]
                    edge = edges[row, vertex, 0], edges[row, vertex, 1], edges[row, vertex, 2]
                    ux, uy, uz = rotated_by_gibbs((p, q, r), edge)
                    scale = rest_length[own, vertex] / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
                    x, y, z = x + scale * ux, y + scale * uy, z + scale * uz
    return hair
