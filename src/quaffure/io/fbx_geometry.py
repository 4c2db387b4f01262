"""Geometry of an FBX file: polygons as triangles, texture coordinates, and the shapes that it is morphed to."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from quaffure.io.fbx_document import FbxDocument, FbxObject
from quaffure.io.fbx_records import FbxRecord

BYTES_A_CORNER = 200  # of a polygon, while it is cut into triangles
BYTES_A_VERTEX = 300  # while it is placed
BYTES_A_SHAPE_VERTEX = 24
PERCENT = 100.0
"""Weight of a shape that is reached at full strength."""


@dataclass(frozen=True, eq=False)
class MorphChannel:
    """A slider of a geometry, which has one shape or several that follow one another.

    Attributes:
        channel: its object; animations move its property DeformPercent.
        targets: the shapes, by their place among those of the geometry.
        full: weights at which each shape is reached [percent].
        weight: at rest [percent].
    """

    channel: FbxObject
    targets: tuple[int, ...]
    full: Float[np.ndarray, " k"]
    weight: float

    def weights(self, percent: Float[np.ndarray, " f"]) -> Float[np.ndarray, "f k"]:
        """Weights of the shapes; between two of several they are mixed."""
        if len(self.targets) == 1:
            return (percent / self.full[0])[:, None]
        places = np.concatenate([[0.0], self.full])
        right = np.searchsorted(places, percent, side="right").clip(1, len(places) - 1)
        share = ((percent - places[right - 1]) / (places[right] - places[right - 1])).clip(0, 1)
        weights, row = np.zeros((len(percent), len(places))), np.arange(len(percent))
        weights[row, right - 1], weights[row, right] = 1 - share, share
        return weights[:, 1:]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Triangles of a geometry.

    Attributes:
        source: vertex of the file that each vertex is.
        vertices: in the space of the geometry [units of the file].
        faces: triangles.
        face_materials: index of the material of each triangle among those of its model.
        uv: texture coordinates, v down, where the file has them.
        targets: differences of the shapes from `vertices` [units of the file], by name.
        channels: that move them.
        vertex_count: vertices of the file.
    """

    source: Int[np.ndarray, " v"]
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]
    face_materials: Int[np.ndarray, " k"]
    uv: Float[np.ndarray, "v 2"] | None
    vertex_count: int
    targets: list[tuple[str, Float[np.ndarray, "v 3"]]] = field(default_factory=list)
    channels: list[MorphChannel] = field(default_factory=list)


def read_geometry(document: FbxDocument, geometry: FbxObject) -> Geometry | None:
    """A geometry of the kind Mesh; None of one without polygons.

    Raises:
        InputError: polygons, texture coordinates or shapes of vertices that there are not, arrays of another size than
            they have, numbers that are not finite, or more memory than a file of this size should need.
    """
    record = geometry.record
    listed, polygons = record.child("Vertices"), record.child("PolygonVertexIndex")
    if listed is None or polygons is None or not polygons.values or not listed.values:
        return None
    vertices, ends = listed.floats(3), polygons.integers()
    record.reserve(BYTES_A_VERTEX * len(vertices) + BYTES_A_CORNER * len(ends))
    corners, polygon = _polygons(ends, len(vertices), polygons)
    triangles = _fans(polygon)
    if not len(triangles):
        return None
    materials = _materials(record, polygon)[triangles[:, 0]]
    source, vertex_of_corner, uv = _split(record, corners, len(vertices))
    found = Geometry(source, vertices[source], vertex_of_corner[triangles], materials, uv, len(vertices))
    _add_shapes(document, geometry, found)
    return found


def _polygons(
    ends: Int[np.ndarray, " c"], vertex_count: int, record: FbxRecord
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Vertex and polygon of every corner; the last corner of a polygon is written as -1 - vertex.

    Raises:
        InputError: vertices that there are not, or a polygon without an end.
    """
    corners = np.where(ends < 0, ~ends, ends)
    if not len(ends) or int(corners.max()) >= vertex_count:
        record.fail(f"vertices below {vertex_count}", "others or none")
    if ends[-1] >= 0:
        record.fail("polygons that end", "one that does not")
    polygon = np.zeros(len(ends), dtype=np.int64)
    polygon[1:] = np.cumsum(ends[:-1] < 0)
    return corners, polygon


def _fans(polygon: Int[np.ndarray, " c"]) -> Int[np.ndarray, "k 3"]:
    """Corners of the triangles from the first corner of each polygon; none of points and lines."""
    corner = np.arange(len(polygon))
    first = np.searchsorted(polygon, polygon)
    is_middle = (corner > first) & (np.append(polygon[1:], -1) == polygon)
    middle = corner[is_middle]
    return np.stack([first[middle], middle, middle + 1], axis=1)


def _materials(record: FbxRecord, polygon: Int[np.ndarray, " c"]) -> Int[np.ndarray, " c"]:
    """Index of the material at every corner; 0 without a layer of materials."""
    layer = record.child("LayerElementMaterial")
    listed = None if layer is None else layer.child("Materials")
    if layer is None or listed is None or not listed.values:
        return np.zeros(len(polygon), np.int64)
    indices, mapping = listed.integers(), _mapping(layer)
    if mapping == "AllSame" and len(indices):
        return np.full(len(polygon), indices[0])
    if mapping == "ByPolygon" and len(indices) > polygon[-1]:
        return indices[polygon]
    return np.zeros(len(polygon), np.int64)


def _split(
    record: FbxRecord, corners: Int[np.ndarray, " c"], vertex_count: int
) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " c"], Float[np.ndarray, "v 2"] | None]:
    """Vertices with one texture coordinate each: their vertex of the file, that of every corner, and coordinates."""
    uv = _uv_of_corners(record, corners)
    if uv is None:
        return np.arange(vertex_count), corners, None
    distinct, number = np.unique(uv[:, 0] + 1j * uv[:, 1], return_inverse=True)
    pairs, vertex_of_corner = np.unique(corners * len(distinct) + number, return_inverse=True)
    chosen = distinct[pairs % len(distinct)]
    return pairs // len(distinct), vertex_of_corner, np.stack([chosen.real, 1 - chosen.imag], axis=1)


def _uv_of_corners(record: FbxRecord, corners: Int[np.ndarray, " c"]) -> Float[np.ndarray, "c 2"] | None:
    """Texture coordinates of every corner, v up, of the first layer; None without one.

    Raises:
        InputError: fewer indices or coordinates than corners need.
    """
    layer = record.child("LayerElementUV")
    listed = None if layer is None else layer.child("UV")
    if layer is None or listed is None or not listed.values:
        return None
    uv, mapping = listed.floats(2), _mapping(layer)
    if mapping == "ByPolygonVertex":
        index = np.arange(len(corners))
    elif mapping in ("ByVertice", "ByVertex"):
        index = corners
    else:
        return None
    indices = layer.child("UVIndex")
    if indices is not None and indices.values:
        known = indices.integers()
        if not index.max() < len(known):
            indices.fail(f"{index.max() + 1} indices", f"{len(known)}")
        index = np.where(known[index] == -1, 0, known[index])  # -1: a corner without a coordinate
    if index.min() < 0 or index.max() >= len(uv):
        listed.fail("a texture coordinate for every corner", f"{len(uv)} of them")
    return uv[index]


def _mapping(layer: FbxRecord) -> str:
    """What the rows of a layer belong to."""
    record = layer.child("MappingInformationType")
    return "" if record is None else record.text(0)


def _add_shapes(document: FbxDocument, geometry: FbxObject, found: Geometry) -> None:
    """Add the shapes of a geometry, and what moves them."""
    for deformer in document.below(geometry, "Deformer", "BlendShape"):
        for channel in document.below(deformer, "Deformer", "BlendShapeChannel"):
            shapes = document.below(channel, "Geometry", "Shape")
            if not shapes:
                continue
            first = len(found.targets)
            for place, shape in enumerate(shapes):
                name = channel.name or shape.name
                found.targets.append((name if not place else f"{name} {place}", _differences(shape, found)))
            weight = channel.properties.number("DeformPercent", 0.0)
            targets = tuple(range(first, len(found.targets)))
            found.channels.append(MorphChannel(channel, targets, _full_weights(channel, len(shapes)), weight))


def _full_weights(channel: FbxObject, shapes: int) -> Float[np.ndarray, " k"]:
    """Weights at which the shapes of a channel are reached [percent], rising.

    Raises:
        InputError: another number of weights than of shapes, or weights that do not rise from 0.
    """
    record = channel.record.child("FullWeights")
    weights = np.zeros(0) if record is None or not record.values else record.floats(1)[:, 0]
    if shapes == 1:  # some programs write a weight for every vertex here
        weights = weights[:1] if len(weights) and weights[0] > 0 else np.array([PERCENT])
    if len(weights) != shapes or not (np.diff(weights, prepend=0.0) > 0).all():
        channel.fail(f"{shapes} rising weights of its shapes", f"{len(weights)} weights")
    return weights


def _differences(shape: FbxObject, found: Geometry) -> Float[np.ndarray, "v 3"]:
    """Differences of all vertices [units of the file]; the file has those that are not 0.

    Raises:
        InputError: another number of differences than of vertices, or vertices that there are not.
    """
    record = shape.record
    record.reserve(BYTES_A_SHAPE_VERTEX * (found.vertex_count + len(found.source)))
    moved = np.zeros((found.vertex_count, 3), np.float32)
    indexes = record.child("Indexes")
    if indexes is not None and indexes.values:
        vertices, differences = indexes.integers(), record.required("Vertices").floats(3)
        if len(differences) != len(vertices):
            record.fail(f"{len(vertices)} differences, as many as vertices", f"{len(differences)}")
        if len(vertices) and not 0 <= int(vertices.min()) <= int(vertices.max()) < found.vertex_count:
            indexes.fail(f"vertices below {found.vertex_count}", "others")
        moved[vertices] = differences
    return moved[found.source]
