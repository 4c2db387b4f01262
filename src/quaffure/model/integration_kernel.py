"""Compiled rotation of edges by the network, and their integration."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.geometry.mls_kernels import FAST
from quaffure.geometry.rotation_kernel import rotated_by_gibbs
from quaffure.model.bfloat16 import stored


class ShapeRows(NamedTuple):
    """Rows of a `quaffure.model.initial_shape.InitialShape`."""

    roots: np.ndarray
    edges: np.ndarray
    compliance: np.ndarray


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _rotate(shape: ShapeRows, row: int, changes: np.ndarray, bits: np.ndarray, rotated: np.ndarray) -> None:
    """Write the unit edges [edge, 3] of a row, each rotated by the sum of the network's outputs before it.

    Args:
        changes: of the row, the bits of float32, or of bfloat16.
        bits: memory for them as float32.
    """
    p, q, r = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    shift, change = np.uint32(32 - 8 * changes.itemsize), bits.view(np.float32)
    for k in range(len(changes)):
        bits[k] = np.uint32(changes[k]) << shift
    for edge in range(len(rotated)):
        half = np.float32(0.5) * shape.compliance[row, edge]
        p += half * change[3 * edge]
        q += half * change[3 * edge + 1]
        r += half * change[3 * edge + 2]
        own = shape.edges[row, edge, 0], shape.edges[row, edge, 1], shape.edges[row, edge, 2]
        x, y, z = rotated_by_gibbs((p, q, r), own)
        scale = np.float32(1.0) / np.sqrt(x * x + y * y + z * z + np.float32(1e-24))
        rotated[edge, 0], rotated[edge, 1], rotated[edge, 2] = scale * x, scale * y, scale * z


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def rotate_edges(
    shape: ShapeRows, changes: np.ndarray, rest_length: np.ndarray, threads: int, rotated: np.ndarray,
    features: np.ndarray,
) -> None:  # fmt: skip
    """Write the edges [row, edge, 3] as the network's outputs rotate them, and in the first columns of the features
    the positions of all vertices but the root [m, head's frame].

    Args:
        changes, features: of each row, the bits of float32, or of bfloat16.
        rest_length: [row, edge]; there may be fewer rows than in the other arrays, whose last ones are left out.
    """
    spaces = np.empty((threads, changes.shape[1]), np.uint32)
    for thread in prange(threads):
        bits = spaces[thread]
        for row in range(thread, len(rest_length), threads):
            _rotate(shape, row, changes[row], bits, rotated[row])
            position = bits.view(np.float32)
            for axis in range(3):
                value = shape.roots[row, axis]
                for edge in range(rest_length.shape[1]):
                    value += rest_length[row, edge] * rotated[row, edge, axis]
                    position[3 * edge + axis] = value
            for k in range(len(bits)):
                features[row, k] = stored(bits[k], features.itemsize)


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def integrate_edges(
    shape: ShapeRows, changes: np.ndarray, strand: np.ndarray, rest_length: np.ndarray, world_from_head: np.ndarray,
    head: np.ndarray, threads: int,
) -> np.ndarray:  # fmt: skip
    """Vertices [strand, vertex, 3] [m, world] of edges rotated by the network's outputs, in the order of `rest_length`
    [strand, edge].

    Args:
        changes: of each row, the bits of float32, or of bfloat16.
        strand: of each row.
    """
    count = shape.edges.shape[1]
    hair = np.empty((len(rest_length), count + 1, 3), np.float32)
    spaces, edges = np.empty((threads, changes.shape[1]), np.uint32), np.empty((threads, count, 3), np.float32)
    a, b, c = world_from_head[0], world_from_head[1], world_from_head[2]
    for thread in prange(threads):
        rotated = edges[thread]
        for row in range(thread, len(rest_length), threads):  # the rows after these repeat the last strand
            _rotate(shape, row, changes[row], spaces[thread], rotated)
            own, x, y, z = strand[row], shape.roots[row, 0], shape.roots[row, 1], shape.roots[row, 2]
            for vertex in range(count + 1):
                hair[own, vertex, 0] = head[0] + a[0] * x + a[1] * y + a[2] * z
                hair[own, vertex, 1] = head[1] + b[0] * x + b[1] * y + b[2] * z
                hair[own, vertex, 2] = head[2] + c[0] * x + c[1] * y + c[2] * z
                if vertex < count:
                    length = rest_length[own, vertex]
                    x += length * rotated[vertex, 0]
                    y += length * rotated[vertex, 1]
                    z += length * rotated[vertex, 2]
    return hair
