"""A posed, closed triangle surface with everything that nearest-face searches need."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numba import njit, prange

from quaffure.geometry.binary_bvh import BinaryBvh, build_binary_bvh, refit
from quaffure.geometry.bvh import Bvh, allocate_bvh, refit_bvh
from quaffure.geometry.mesh import angle_weighted_vertex_normals, face_normals, opposite_faces
from quaffure.geometry.occupancy_grid import (
    CELLS,
    MOST_SPLIT,
    ORIGIN,
    OccupancyGrid,
    flood_clear_cells,
    split_near_cells,
)
from quaffure.types import MeshFaces, MeshVertices, Tensor


@dataclass(frozen=True)
class SurfaceTopology:
    """What stays the same in every pose: faces and the search tree over them.

    Attributes:
        faces: vertex indices of every face, counter-clockwise seen from outside.
        tree: built over some representative pose; valid for all, fastest near that one.
        tree_faces: `faces` in the order of the tree's leaves.
        tree_opposite: for each place and edge in that order, the place of the face across the edge.
    """

    faces: MeshFaces
    tree: BinaryBvh
    tree_faces: Int[np.ndarray, "k 3"]
    tree_opposite: Int[np.ndarray, "k 3"]


@dataclass(frozen=True)
class Surface:
    """A batch of poses of one closed mesh.

    Attributes:
        topology: shared by the batch.
        vertices: positions [m].
        corners: corner positions in the leaves' order [m].
        bounds: boxes of the tree's nodes, lower then upper corner [m].
        normals: pseudonormals of each face in the leaves' order: the face, its three edges, its three corners; not
            unit. The sign of a point is that of its offset along the normal of its nearest feature
            (Baerentzen and Aanaes 2005).
        wide: the tree that nearest faces are sought in.
        map: what is known of each place in space round the head; see `quaffure.geometry.occupancy_grid`.
    """

    topology: SurfaceTopology
    vertices: MeshVertices
    corners: Float[np.ndarray, "b k 3 3"]
    bounds: Float[np.ndarray, "b m 6"]
    normals: Float[np.ndarray, "b k 7 3"]
    wide: Bvh
    map: OccupancyGrid

    def bvh(self, sample: int) -> Bvh:
        """The tree of one pose."""
        return Bvh(self.wide.blocks[sample], self.wide.boxes[sample], self.wide.levels)


def surface_topology(vertices: Float[Tensor, "v 3"], faces: MeshFaces) -> SurfaceTopology:
    """Topology of a mesh whose tree is built over `vertices`.

    Raises:
        ValueError: the mesh is not closed and consistently oriented.
    """
    opposite = opposite_faces(faces).cpu().numpy()
    faces_array = faces.cpu().numpy()
    tree = build_binary_bvh(vertices.detach().cpu().numpy(), faces_array)
    place_of_face = np.empty(len(faces_array), np.int32)
    place_of_face[tree.face_order] = np.arange(len(faces_array), dtype=np.int32)
    return SurfaceTopology(
        faces=faces,
        tree=tree,
        tree_faces=faces_array[tree.face_order].astype(np.int32),
        tree_opposite=place_of_face[opposite[tree.face_order]],
    )


def posed_surface(
    topology: SurfaceTopology, vertices: MeshVertices, focus: Float[Tensor, "b 3"] | None = None
) -> Surface:
    """Refit the search structures to a batch of posed vertices [m].

    Args:
        focus: where hair hangs from, the head [m]: round it free space is mapped. Without it, round the mean vertex.
    """
    array = np.ascontiguousarray(vertices.detach().cpu().numpy(), dtype=np.float32)
    centre = array.mean(axis=1) if focus is None else focus.detach().cpu().numpy().astype(np.float32)
    batch, places, nodes = len(array), len(topology.tree_faces), len(topology.tree.first)
    grid = (batch, CELLS, CELLS, CELLS)
    surface = Surface(
        topology=topology,
        vertices=vertices,
        corners=np.empty((batch, places, 3, 3), np.float32),
        bounds=np.empty((batch, nodes, 6), np.float32),
        normals=np.empty((batch, places, 7, 3), np.float32),
        wide=allocate_bvh(topology.tree.levels, batch),
        map=OccupancyGrid(
            centre + ORIGIN,
            np.empty(grid, np.uint8),
            np.empty(grid, np.int32),
            np.empty((batch, MOST_SPLIT), np.uint64),
            np.empty((batch, MOST_SPLIT), np.uint64),
        ),
    )
    _fill(
        array, topology.tree_faces, topology.tree_opposite, topology.tree.first, topology.tree.second,
        surface.corners, surface.bounds, surface.normals, surface.wide, surface.map,
    )  # fmt: skip
    return surface


@njit(cache=True, parallel=True)
def _fill(
    vertices: np.ndarray,
    faces: np.ndarray,
    opposite: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    corners: np.ndarray,
    bounds: np.ndarray,
    normals: np.ndarray,
    wide: Bvh,
    space: OccupancyGrid,
) -> None:
    for sample in prange(len(vertices)):
        for place in range(len(faces)):
            for corner in range(3):
                for axis in range(3):
                    corners[sample, place, corner, axis] = vertices[sample, faces[place, corner], axis]
        _pseudonormals(corners[sample], faces, opposite, vertices.shape[1], normals[sample])
        refit(corners[sample], first, second, bounds[sample])
        refit_bvh(corners[sample], Bvh(wide.blocks[sample], wide.boxes[sample], wide.levels))
        flood_clear_cells(
            corners[sample], normals[sample], bounds[sample], first, second, space.origin[sample], space.clear[sample]
        )
        split_near_cells(
            corners[sample],
            OccupancyGrid(
                space.origin[sample], space.clear[sample], space.slot[sample], space.outside[sample], space.free[sample]
            ),
        )


@njit(cache=True, fastmath=True)
def _pseudonormals(
    corners: np.ndarray, faces: np.ndarray, opposite: np.ndarray, vertex_count: int, normals: np.ndarray
) -> None:
    at_vertex = np.zeros((vertex_count, 3), np.float32)
    tiny = np.float32(1e-20)
    for place in range(len(faces)):
        face = corners[place]
        ax, ay, az = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1], face[1, 2] - face[0, 2]
        bx, by, bz = face[2, 0] - face[1, 0], face[2, 1] - face[1, 1], face[2, 2] - face[1, 2]
        cx, cy, cz = face[0, 0] - face[2, 0], face[0, 1] - face[2, 1], face[0, 2] - face[2, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        twice_area = np.sqrt(nx * nx + ny * ny + nz * nz)
        inverse = np.float32(1.0) / (twice_area + tiny)
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        normals[place, 0, 0], normals[place, 0, 1], normals[place, 0, 2] = nx, ny, nz
        cosines = (-(cx * ax + cy * ay + cz * az), -(ax * bx + ay * by + az * bz), -(bx * cx + by * cy + bz * cz))
        for corner in range(3):
            angle = np.arctan2(twice_area, cosines[corner])
            at_vertex[faces[place, corner], 0] += angle * nx
            at_vertex[faces[place, corner], 1] += angle * ny
            at_vertex[faces[place, corner], 2] += angle * nz
    for place in range(len(faces)):
        for side in range(3):
            for axis in range(3):
                normals[place, 1 + side, axis] = normals[place, 0, axis] + normals[opposite[place, side], 0, axis]
                normals[place, 4 + side, axis] = at_vertex[faces[place, side], axis]


def reference_surface_normals(topology: SurfaceTopology, vertices: MeshVertices) -> Float[Tensor, "b k 7 3"]:
    """The torch twin of the pseudonormals in `Surface.normals`, faces in the mesh's own order."""
    faces = topology.faces
    at_face = face_normals(vertices[:, faces])
    at_edge = at_face[:, :, None] + at_face[:, opposite_faces(faces)]
    at_vertex = angle_weighted_vertex_normals(vertices, faces)[:, faces]
    return torch.cat([at_face[:, :, None], at_edge, at_vertex], dim=2)
