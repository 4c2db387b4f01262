"""A posed, closed triangle surface with the structures that nearest-face searches need."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from numba import njit, prange

from quaffure.geometry.bvh import Bvh, allocate_bvh, bvh_levels, leaf_order, refit_bvh
from quaffure.geometry.mesh import angle_weighted_vertex_normals, face_normals, opposite_faces
from quaffure.geometry.occupancy_grid import OccupancyGrid, allocate_occupancy_grid, fill_occupancy_grid
from quaffure.types import MeshFaces, MeshVertices, Tensor


@dataclass(frozen=True)
class SurfaceTopology:
    """What stays the same in every pose: faces and their leaf order.

    Attributes:
        faces: vertex indices of every face, counter-clockwise seen from outside.
        face_order: the face of every leaf. Made for some representative pose; valid for all, fastest near that one.
        leaf_faces: `faces` in the leaf order.
        leaf_opposite: for each leaf and edge, the leaf of the face across the edge.
    """

    faces: MeshFaces
    face_order: Int[np.ndarray, " k"]
    leaf_faces: Int[np.ndarray, "k 3"]
    leaf_opposite: Int[np.ndarray, "k 3"]


class SurfaceArrays(NamedTuple):
    """What kernels read of one posed surface, or of each of a batch with one more axis in front of all but `levels`.

    Flat, for parallel kernels take no tuples within tuples.

    Attributes:
        corners: corner positions in the leaf order [k, 3, 3] [m].
        normals: pseudonormals of each face in the leaf order: the face, its three edges, its three corners; not
            unit [k, 7, 3]. The sign of a point is that of its offset along the normal of its nearest feature
            (Baerentzen and Aanaes 2005).
        blocks, boxes, levels: of `Bvh`.
        origin, clear, slot, outside, free: of `OccupancyGrid`.
    """

    corners: np.ndarray
    normals: np.ndarray
    blocks: np.ndarray
    boxes: np.ndarray
    levels: np.ndarray
    origin: np.ndarray
    clear: np.ndarray
    slot: np.ndarray
    outside: np.ndarray
    free: np.ndarray


@njit(cache=True, inline="always")
def sample_arrays(arrays: SurfaceArrays, sample: int) -> SurfaceArrays:
    """One of a batch, without a copy."""
    return SurfaceArrays(
        arrays.corners[sample], arrays.normals[sample], arrays.blocks[sample], arrays.boxes[sample], arrays.levels,
        arrays.origin[sample], arrays.clear[sample], arrays.slot[sample], arrays.outside[sample], arrays.free[sample],
    )  # fmt: skip


@njit(cache=True, inline="always")
def bvh_of(arrays: SurfaceArrays) -> Bvh:
    return Bvh(arrays.blocks, arrays.boxes, arrays.levels)


@njit(cache=True, inline="always")
def occupancy_of(arrays: SurfaceArrays) -> OccupancyGrid:
    return OccupancyGrid(arrays.origin, arrays.clear, arrays.slot, arrays.outside, arrays.free)


@dataclass(frozen=True)
class Surface:
    """A batch of poses of one closed mesh.

    Attributes:
        topology: shared by the batch.
        vertices: positions [m].
        arrays: of the whole batch.
    """

    topology: SurfaceTopology
    vertices: MeshVertices
    arrays: SurfaceArrays

    def sample_arrays(self, sample: int) -> SurfaceArrays:
        """What kernels read of one pose."""
        one: SurfaceArrays = sample_arrays.py_func(self.arrays, sample)
        return one

    def samples(self, samples: slice) -> "Surface":
        """A part of the batch, without a copy."""
        levels = self.arrays.levels
        parts = SurfaceArrays(*(field[samples] for field in self.arrays))
        return Surface(self.topology, self.vertices[samples], parts._replace(levels=levels))


def surface_topology(vertices: Float[Tensor, "v 3"], faces: MeshFaces) -> SurfaceTopology:
    """Topology of a mesh whose leaf order is made for `vertices`.

    Raises:
        ValueError: the mesh is not closed and consistently oriented.
    """
    opposite = opposite_faces(faces).cpu().numpy()
    faces_array = faces.cpu().numpy()
    order = leaf_order(vertices.detach().cpu().numpy(), faces_array)
    leaf_of_face = np.empty(len(faces_array), np.int32)
    leaf_of_face[order] = np.arange(len(faces_array), dtype=np.int32)
    return SurfaceTopology(faces, order, faces_array[order].astype(np.int32), leaf_of_face[opposite[order]])


def posed_surface(
    topology: SurfaceTopology, vertices: MeshVertices, focus: Float[Tensor, "b 3"] | None = None
) -> Surface:
    """Refit the search structures to a batch of posed vertices [m].

    Args:
        focus: where hair hangs from, the head [m]: round it free space is mapped. Without it, round the mean vertex.
    """
    array = np.ascontiguousarray(vertices.detach().cpu().numpy(), dtype=np.float32)
    centre = array.mean(axis=1) if focus is None else focus.detach().cpu().numpy().astype(np.float32)
    batch, leaves = len(array), len(topology.leaf_faces)
    arrays = SurfaceArrays(
        np.empty((batch, leaves, 3, 3), np.float32),
        np.empty((batch, leaves, 7, 3), np.float32),
        *allocate_bvh(bvh_levels(leaves), batch),
        *allocate_occupancy_grid(centre),
    )
    _fill(array, topology.leaf_faces, topology.leaf_opposite, arrays)
    return Surface(topology, vertices, arrays)


@njit(cache=True, parallel=True)
def _fill(vertices: np.ndarray, faces: np.ndarray, opposite: np.ndarray, arrays: SurfaceArrays) -> None:
    for sample in prange(len(vertices)):
        one = sample_arrays(arrays, sample)
        _write_faces(vertices[sample], faces, opposite, one.corners, one.normals)
        refit_bvh(one.corners, bvh_of(one))
        fill_occupancy_grid(one.corners, one.normals, bvh_of(one), occupancy_of(one))


# Called, not written out in the parallel loop: numba drops assignments to fields of a tuple there as dead code.
@njit(cache=True, fastmath=True)
def _write_faces(
    vertices: np.ndarray, faces: np.ndarray, opposite: np.ndarray, corners: np.ndarray, normals: np.ndarray
) -> None:
    """Fill corners and pseudonormals."""
    at_vertex = np.zeros_like(vertices)
    tiny = np.float32(1e-20)
    for leaf in range(len(faces)):
        face = corners[leaf]
        for corner in range(3):
            for axis in range(3):
                face[corner, axis] = vertices[faces[leaf, corner], axis]
        ax, ay, az = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1], face[1, 2] - face[0, 2]
        bx, by, bz = face[2, 0] - face[1, 0], face[2, 1] - face[1, 1], face[2, 2] - face[1, 2]
        cx, cy, cz = face[0, 0] - face[2, 0], face[0, 1] - face[2, 1], face[0, 2] - face[2, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        twice_area = np.sqrt(nx * nx + ny * ny + nz * nz)
        inverse = np.float32(1.0) / (twice_area + tiny)
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        normals[leaf, 0, 0], normals[leaf, 0, 1], normals[leaf, 0, 2] = nx, ny, nz
        cosines = (-(cx * ax + cy * ay + cz * az), -(ax * bx + ay * by + az * bz), -(bx * cx + by * cy + bz * cz))
        for corner in range(3):
            angle = np.arctan2(twice_area, cosines[corner])
            at_vertex[faces[leaf, corner], 0] += angle * nx
            at_vertex[faces[leaf, corner], 1] += angle * ny
            at_vertex[faces[leaf, corner], 2] += angle * nz
    for leaf in range(len(faces)):
        for side in range(3):
            for axis in range(3):
                normals[leaf, 1 + side, axis] = normals[leaf, 0, axis] + normals[opposite[leaf, side], 0, axis]
                normals[leaf, 4 + side, axis] = at_vertex[faces[leaf, side], axis]


def reference_surface_normals(topology: SurfaceTopology, vertices: MeshVertices) -> Float[Tensor, "b k 7 3"]:
    """The torch twin of the pseudonormals in `Surface.normals`, faces in the mesh's own order."""
    faces = topology.faces
    at_face = face_normals(vertices[:, faces])
    at_edge = at_face[:, :, None] + at_face[:, opposite_faces(faces)]
    at_vertex = angle_weighted_vertex_normals(vertices, faces)[:, faces]
    return torch.cat([at_face[:, :, None], at_edge, at_vertex], dim=2)
