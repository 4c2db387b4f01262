"""One closed surface around a character, whatever its meshes are: open, of several pieces, or crossing each other.

What is inside is what the generalized winding number of all skin says [Jacobson et al. 2013, "Robust inside-outside
segmentation using generalized winding numbers"]. Mouth, nostrils and eyes are closed morphologically: the surface is
moved outwards by a radius and back inwards. Both steps are level sets of a signed distance on a grid that is stored
near them only. The result is simplified by collapsing its shortest edges, finest at the head; by quadric errors, flat
parts would get slivers, whose frames hair could not follow. Its vertices are then spread evenly and moved onto the
skin.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from quaffure.errors import InputError
from quaffure.geometry.hole_filling import boundary_loops, fill_loop

CLOSING_RADIUS = 0.004
"""Openings narrower than twice this are closed [m]."""
CELL = 0.003
"""Edge of a cell of the grid [m]."""
BLOCK = 8
"""Cells of the grid in a block, which is left out where the surface does not pass."""
PARTS = 4
"""Parts of a block along an axis: most of them are left out before distances of cells are measured."""
MARGIN = 0.012
"""Width of the grid around the mesh [m]."""
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
"""Corners of a cell, in the order that igl expects."""
SAMPLES_AT_ONCE = 2_000_000
WELD = 1e-6
"""Vertices of a mesh that are as near as this are one [m]."""
SNAP = 0.0025
"""Vertices nearer to the skin than this are moved onto it [m]."""
LEAST_VOLUME = 2e-5
"""Pieces smaller than this are left out [m^3]."""
RELAXATIONS = 4
FACES = 24000
"""Number of triangles of the result."""
FINE_RADIUS, COARSENING = 0.16, 1.5
"""The radius around the middle of the head within which the surface is fine, and the radius over which triangles grow
to twice their length, in units of the first."""
WIDEST = 4.0
"""Largest extent of a mesh, in heights of the figure: the grid has blocks wherever its bounding box is."""


class Triangles(NamedTuple):
    """A mesh.

    Attributes:
        vertices: [m].
        faces: counterclockwise from outside.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]


def check_extent(name: str, vertices: Float[np.ndarray, "v 3"], joints: Float[np.ndarray, "j 3"], source: str) -> None:
    """Refuse a mesh with a vertex far from the figure, before there is a grid around it.

    Args:
        name: of the mesh.
        joints: of the figure, in the unit of the vertices; their largest extent is its height.
        source: the file.

    Raises:
        InputError: it is wider than `WIDEST` heights.
    """
    height = float(np.ptp(joints, axis=0).max())
    extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    if not extent <= WIDEST * height:
        found = f"one of {extent / height:.3g} heights" if height > 0 else "joints in one place"
        raise InputError(f"{source}, mesh {name}", f"a mesh within {WIDEST:g} heights of the figure", found)


def closed_surface(skin: Triangles, head: Float[np.ndarray, "3"], cell: float = CELL) -> Triangles:
    """A closed surface around everything that is inside of a mesh.

    Args:
        head: the middle of the head, where triangles are smallest [m].
        cell: of the grid [m].

    Raises:
        ValueError: the surface has holes, which is a fault of this function.
    """
    skin = _welded(skin)
    outer = _pieces(_level_set(skin, CLOSING_RADIUS, cell))
    closed = _pieces(_level_set(outer, -CLOSING_RADIUS, cell))
    simple = _on_skin(_simplified(closed, head), skin)
    for _ in range(RELAXATIONS):
        simple = _on_skin(_relaxed(simple), skin)
    if boundary_loops(simple.faces):
        raise ValueError("the collision surface has holes")
    return simple


def _welded(mesh: Triangles) -> Triangles:
    """The mesh with one vertex at each place, where files have several along seams of the texture; inside out if it
    was outside in."""
    _, first, index = np.unique(np.round(mesh.vertices / WELD), axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    welded = Triangles(mesh.vertices[first], faces)
    return welded if _volume(welded) > 0 else Triangles(welded.vertices, faces[:, ::-1])


def distance_to(points: Float[np.ndarray, "p 3"], mesh: Triangles) -> Float[np.ndarray, " p"]:
    """Unsigned distance of points from a mesh [m]."""
    import igl

    squared = igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))[0]
    return np.sqrt(np.maximum(squared, 0.0))


def closest_on(
    points: Float[np.ndarray, "p 3"], mesh: Triangles
) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """Face, barycentric coordinates and position of the closest point of a mesh."""
    import igl

    _, face, closest = igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))
    face = face.astype(np.int64)  # igl's own 64-bit integers are another type for numpy
    corners = mesh.vertices[mesh.faces[face]]
    weights = igl.barycentric_coordinates(closest, *(np.ascontiguousarray(corners[:, k]) for k in range(3)))
    weights = np.clip(np.nan_to_num(weights, nan=1 / 3), 0.0, 1.0)
    return face, weights / weights.sum(1, keepdims=True), closest


def _level_set(mesh: Triangles, level: float, cell: float) -> Triangles:
    """The surface at a signed distance from the inside of a mesh, positive outwards [m]."""
    import igl

    vertices, faces = np.ascontiguousarray(mesh.vertices), mesh.faces.astype(np.int64)
    low = vertices.min(0) - MARGIN - max(level, 0.0)
    cells = _cells(mesh, level, low, cell)
    shape = cells.max(0) + 2
    keys = np.ravel_multi_index(tuple((cells[:, None] + CORNERS).reshape(-1, 3).T), shape)
    unique, index = np.unique(keys, return_inverse=True)
    points = low + cell * np.stack(np.unravel_index(unique, shape), 1)
    kind = igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    parts = np.array_split(points, -(-len(points) // SAMPLES_AT_ONCE))
    values = np.concatenate([igl.signed_distance(part, vertices, faces, kind)[0] for part in parts])
    found = igl.marching_cubes(values - level, points, index.reshape(-1, 8).astype(np.int64), 0.0)
    return Triangles(found[0], found[1].astype(np.int64))


def _cells(mesh: Triangles, level: float, low: Float[np.ndarray, "3"], cell: float) -> Int[np.ndarray, "n 3"]:
    """Cells of the grid that a level set can pass."""
    size = BLOCK * cell
    count = np.ceil((mesh.vertices.max(0) + MARGIN + max(level, 0.0) - low) / size).astype(int)
    blocks = _lattice(*count.tolist())
    passed, torn = _near(blocks, size, low, mesh, level), _near_hole(blocks, count, low, size, mesh)
    measured = blocks[passed & ~torn]
    near = _near(_split(measured, PARTS), size / PARTS, low, mesh, level).reshape(-1, PARTS**3)
    part_of_cell = _lattice(BLOCK, BLOCK, BLOCK) * PARTS // BLOCK @ [PARTS**2, PARTS, 1]
    fine = _split(measured, BLOCK)[near[:, part_of_cell].ravel()]
    return np.concatenate([fine[_near(fine, cell, low, mesh, level)], _split(blocks[torn], BLOCK)])


def _split(cells: Int[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, "m 3"]:
    """The `count`^3 cells of a finer grid in each cell."""
    return (count * cells[:, None] + _lattice(count, count, count)).reshape(-1, 3)


def _near(
    cells: Int[np.ndarray, "n 3"], size: float, low: Float[np.ndarray, "3"], mesh: Triangles, level: float
) -> Bool[np.ndarray, " n"]:
    """Cells that the level set can pass where the signed distance is continuous, by the distance of their middle."""
    distance = distance_to(low + size * (cells + 0.5), mesh)
    return np.abs(distance - abs(level)) <= 0.5 * np.sqrt(3) * size


def _near_hole(
    blocks: Int[np.ndarray, "n 3"],
    count: Int[np.ndarray, "3"],
    low: Float[np.ndarray, "3"],
    size: float,
    mesh: Triangles,
) -> Bool[np.ndarray, " n"]:
    """Blocks in which inside and outside can meet away from the mesh, across a hole of it, where the sign of the
    distance changes at any distance."""
    import igl

    rim = np.unique([vertex for loop in boundary_loops(mesh.faces) for vertex in loop]).astype(int)
    if not len(rim):
        return np.zeros(len(blocks), dtype=bool)
    corners = low + size * _lattice(*(count + 1).tolist())
    winding = igl.fast_winding_number(np.ascontiguousarray(mesh.vertices), mesh.faces.astype(np.int64), corners)
    inside = (winding > 0.5).reshape(count + 1)
    corner = np.stack([inside[tuple((blocks + offset).T)] for offset in CORNERS])
    distance = distance_to(low + size * (blocks + 0.5), mesh)
    across = (corner.any(0) & ~corner.all(0)) & (distance > 0.5 * np.sqrt(3) * size)
    near, _ = cKDTree(mesh.vertices[rim]).query(low + size * (blocks + 0.5))
    return across | (near < np.sqrt(3) * size)


def _lattice(x: int, y: int, z: int) -> Int[np.ndarray, "n 3"]:
    return np.stack(np.meshgrid(np.arange(x), np.arange(y), np.arange(z), indexing="ij"), -1).reshape(-1, 3)


def _volume(mesh: Triangles) -> float:
    """[m^3]."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((np.cross(a, b) * c).sum()) / 6


def _pieces(mesh: Triangles) -> Triangles:
    """The connected pieces that are outsides and no crumbs, in one mesh without holes."""
    import igl

    _, of_face = igl.facet_components(mesh.faces)
    kept = np.zeros(len(mesh.faces), dtype=bool)
    for piece in range(of_face.max() + 1):
        faces = of_face == piece
        kept |= faces & (_volume(Triangles(mesh.vertices, mesh.faces[faces])) > LEAST_VOLUME)
    used, flat = np.unique(mesh.faces[kept], return_inverse=True)
    vertices, faces = mesh.vertices[used], flat.reshape(-1, 3)
    # Marching cubes leaves out a triangle where a corner's value is zero.
    return Triangles(vertices, np.concatenate([faces, *(fill_loop(loop, vertices) for loop in boundary_loops(faces))]))


def _simplified(mesh: Triangles, head: Float[np.ndarray, "3"]) -> Triangles:
    """Fewer faces, of equal size in a space in which what is far from the head is small."""
    import igl

    warped = np.asfortranarray(_warped(mesh.vertices, head))
    vertices, faces, _, _ = igl.decimate(warped, np.asfortranarray(mesh.faces.astype(np.int32)), FACES)
    return Triangles(np.ascontiguousarray(_unwarped(vertices, head)), faces.astype(np.int64, order="C"))


def _relaxed(mesh: Triangles) -> Triangles:
    """Vertices moved along the surface, halfway to the mean of their neighbours."""
    import igl

    normals = igl.per_vertex_normals(mesh.vertices, mesh.faces)
    step = neighbour_mean(mesh.faces, len(mesh.vertices)) @ mesh.vertices - mesh.vertices
    step -= (step * normals).sum(1)[:, None] * normals
    return Triangles(mesh.vertices + 0.5 * step, mesh.faces)


def neighbour_mean(faces: Int[np.ndarray, "f 3"], count: int) -> csr_matrix:
    """Matrix that takes the mean over the neighbours of every vertex."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = np.stack(np.divmod(np.unique(edges[:, 0] * count + edges[:, 1]), count), 1)  # faster than of rows
    degree = np.bincount(edges[:, 0], minlength=count)
    return csr_matrix((1.0 / degree[edges[:, 0]], (edges[:, 0], edges[:, 1])), shape=(count, count))


def _warped(points: Float[np.ndarray, "p 3"], head: Float[np.ndarray, "3"]) -> Float[np.ndarray, "p 3"]:
    """Radii r around the head beyond R become R (1 + a ln(1 + (r - R) / (a R)))."""
    offset = points - head
    radius = np.linalg.norm(offset, axis=1, keepdims=True)
    beyond = np.maximum(radius - FINE_RADIUS, 0.0) / (COARSENING * FINE_RADIUS)
    shrunk = FINE_RADIUS * (1 + COARSENING * np.log1p(beyond))
    return head + offset * np.where(radius > FINE_RADIUS, shrunk / np.maximum(radius, 1e-9), 1.0)


def _unwarped(points: Float[np.ndarray, "p 3"], head: Float[np.ndarray, "3"]) -> Float[np.ndarray, "p 3"]:
    offset = points - head
    shrunk = np.linalg.norm(offset, axis=1, keepdims=True)
    beyond = np.expm1(np.maximum(shrunk / FINE_RADIUS - 1, 0.0) / COARSENING)
    radius = FINE_RADIUS * (1 + COARSENING * beyond)
    return head + offset * np.where(shrunk > FINE_RADIUS, radius / np.maximum(shrunk, 1e-9), 1.0)


def _on_skin(mesh: Triangles, skin: Triangles) -> Triangles:
    """Vertices near the skin moved onto it; those across an opening stay."""
    _, _, closest = closest_on(mesh.vertices, skin)
    near = np.linalg.norm(closest - mesh.vertices, axis=1) < SNAP
    return Triangles(np.where(near[:, None], closest, mesh.vertices), mesh.faces)
