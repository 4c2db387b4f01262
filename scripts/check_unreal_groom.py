"""Check Alembic files against the schema of Unreal's grooms: `check_unreal_groom.py ASSET.abc [CACHE.abc]`.

The tables are those of Epic's "Alembic for Grooms Specification", schema 1.5, and of its page on groom caches. The
script needs alembic3d and numpy alone, and nothing of this package, so that it judges files of any exporter.
"""

import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from alembic3d import Abc, AbcGeom


class Attribute(NamedTuple):
    """Types, values in an element, scopes and range of an attribute."""

    types: tuple[str, ...]
    extent: int
    scopes: tuple[str, ...]
    least: float = -np.inf
    most: float = np.inf


CONSTANT, UNIFORM, VERTEX = "con", "uni", "vtx"
FLOAT = ("kFloat32POD", "kFloat64POD")
INTEGER_LIMIT = 2**31 - 1
GROOM_PROPERTIES = {"groom_version_major": ("kInt16POD", 1), "groom_version_minor": ("kInt16POD", 5)}
OPTIONAL_TEXTS = ("groom_tool", "groom_properties")
CURVE_ATTRIBUTES = {
    "groom_guide": Attribute(("kInt8POD", "kInt16POD", "kInt32POD"), 1, (CONSTANT, UNIFORM), 0, 1),
    "groom_group_id": Attribute(("kInt32POD",), 1, (CONSTANT, UNIFORM), 0, INTEGER_LIMIT),
    "groom_group_name": Attribute(("kStringPOD",), 1, (CONSTANT, UNIFORM)),
    "groom_root_uv": Attribute(FLOAT, 2, (UNIFORM,)),
    "groom_id": Attribute(("kInt32POD",), 1, (UNIFORM,), 0, INTEGER_LIMIT),
    "groom_color": Attribute(FLOAT, 3, (VERTEX,), 0),
    "groom_width": Attribute(FLOAT, 1, (CONSTANT, UNIFORM, VERTEX), 0),
    "groom_closest_guides": Attribute(("kInt32POD",), 3, (UNIFORM,), 0, INTEGER_LIMIT),
    "groom_guide_weights": Attribute(("kFloat32POD",), 3, (UNIFORM,), 0),
}
MOST_POINTS = 255
WIDEST = 0.5
"""A hair of 5 mm was meant in another unit [cm]."""
SMALLEST, LARGEST = 3.0, 400.0
"""Extent of a head's hair in one frame [cm]."""
WEIGHT_SLACK = 1e-3


class Curves(NamedTuple):
    """Curves of a file: points of each, attributes by name, and those of the points of a few frames."""

    name: str
    counts: np.ndarray
    attributes: dict[str, np.ndarray]
    frames: int


def check(path: str, is_cache: bool = False) -> tuple[list[str], list[Curves]]:
    """What is wrong with a file, and its curves.

    Args:
        is_cache: a groom cache has more than one frame.
    """
    archive = Abc.IArchive(path)
    found: list[Curves] = []
    faults = [f"{path}: {fault}" for fault in _faults(archive.getTop(), found)]
    if not found:
        faults.append(f"{path}: no curves")
    if is_cache and all(curves.frames < 2 for curves in found):
        faults.append(f"{path}: a groom cache has more than one frame")
    return faults, found


def check_pair(asset: list[Curves], cache: list[Curves]) -> Iterator[str]:
    """What keeps a cache from being played on an asset."""
    if [curves.name for curves in asset] != [curves.name for curves in cache]:
        yield f"asset and cache hold other curves: {[c.name for c in asset]}, {[c.name for c in cache]}"
        return
    for first, second in zip(asset, cache):
        if not np.array_equal(first.counts, second.counts):
            yield f"{first.name}: asset and cache have other numbers of points"
        for name in first.attributes.keys() | second.attributes.keys():
            if not np.array_equal(first.attributes.get(name), second.attributes.get(name)):
                yield f"{first.name}: {name} of asset and cache differ"


def _faults(top: Any, found: list[Curves]) -> Iterator[str]:
    nodes = [child for child in _children(top) if _is_geometry(child)]
    for node in nodes:
        yield from _groom_property_faults(node)
    for node in nodes:
        yield from _node_faults(node, found)
    guides = [c.attributes["groom_id"] for c in found if _is_guide(c) and "groom_id" in c.attributes]
    ids = [c.attributes["groom_id"].ravel() for c in found if "groom_id" in c.attributes]
    if ids and len(np.unique(np.concatenate(ids))) < sum(map(len, ids)):
        yield "groom_id: two curves have the same"
    for curves in found:
        yield from _guide_faults(curves, np.concatenate(guides).ravel() if guides else np.empty(0, int))


def _groom_property_faults(node: Any) -> Iterator[str]:
    """Properties of the groom belong to the topmost node."""
    kind = AbcGeom.ICurves if AbcGeom.ICurves.matches(node.getMetaData()) else AbcGeom.IXform
    properties = kind(node.getParent(), node.getName()).getSchema().getUserProperties()
    headers = {header.getName(): header for header in _headers(properties)}
    for name, (expected, value) in GROOM_PROPERTIES.items():
        if name not in headers:
            yield f"{node.getFullName()}: no property {name}"
            continue
        stored = str(headers[name].getDataType().getPod())
        number = Abc.IInt16Property(properties, name).getValue() if stored == expected else None
        if not headers[name].isScalar() or number != value:
            yield f"{name}: expected the scalar int16 {value}, found {stored} {number}"
    for name in OPTIONAL_TEXTS:
        if name in headers and str(headers[name].getDataType().getPod()) != "kStringPOD":
            yield f"{name}: expected a string"


def _node_faults(node: Any, found: list[Curves]) -> Iterator[str]:
    if AbcGeom.ICurves.matches(node.getMetaData()):
        yield from _curve_faults(node, found)
    for child in _children(node):
        yield from _node_faults(child, found)


def _curve_faults(node: Any, found: list[Curves]) -> Iterator[str]:
    schema = AbcGeom.ICurves(node.getParent(), node.getName()).getSchema()
    frames, where = schema.getNumSamples(), node.getFullName()
    counts = np.array(schema.getValue(_selector(schema, 0)).getCurvesNumVertices(), dtype=np.int64)
    if not len(counts) or counts.min() < 2 or counts.max() > MOST_POINTS:
        yield f"{where}: expected curves of 2 to {MOST_POINTS} points"
    for frame in range(frames):
        sample = schema.getValue(_selector(schema, frame))
        points = np.array(sample.getPositions(), dtype=np.float64).reshape(-1, 3)
        if not np.array_equal(np.array(sample.getCurvesNumVertices()), counts) or len(points) != counts.sum():
            yield f"{where}: the topology of frame {frame} is not that of the first"
        elif not np.isfinite(points).all():
            yield f"{where}: NaN or infinity in frame {frame}"
        elif not SMALLEST < np.ptp(points, axis=0).max() < LARGEST:
            yield f"{where}: expected centimetres, found an extent of {np.ptp(points, axis=0).max():.3g}"
    attributes: dict[str, np.ndarray] = {}
    found.append(Curves(where, counts, attributes, frames))
    parameters = schema.getArbGeomParams()
    for header in _headers(parameters):
        yield from (f"{where}: {fault}" for fault in _attribute_faults(parameters, header, counts, attributes))
    for name, missing in (("groom_width", "1 cm wide"), ("groom_color", "black")):
        if name not in attributes:
            yield f"{where}: without {name} its hair is {missing}"


def _attribute_faults(
    parameters: Any, header: Any, counts: np.ndarray, attributes: dict[str, np.ndarray]
) -> Iterator[str]:
    name = header.getName()
    if not name.startswith("groom_"):
        return
    if name not in CURVE_ATTRIBUTES:
        yield f"{name}: no attribute of the schema"
        return
    expected, data = CURVE_ATTRIBUTES[name], header.getDataType()
    stored, scope = str(data.getPod()), header.getMetaData().get("geoScope")
    if stored not in expected.types or data.getExtent() != expected.extent or not header.isArray():
        yield f"{name}: expected an array of {expected.types}[{expected.extent}], found {stored}[{data.getExtent()}]"
        return
    if scope not in expected.scopes:
        yield f"{name}: expected scope {expected.scopes}, found '{scope}'"
        return
    values = np.array([*parameters.getProperty(name).getValue()]).reshape(-1, expected.extent)
    size = {CONSTANT: 1, UNIFORM: len(counts), VERTEX: int(counts.sum())}[scope]
    if len(values) != size:
        yield f"{name}: expected {size} values, found {len(values)}"
    elif values.dtype.kind in "if" and not ((values >= expected.least) & (values <= expected.most)).all():
        yield f"{name}: expected {expected.least} to {expected.most}, found {values.min()} to {values.max()}"
    elif name == "groom_width" and values.max() > WIDEST:
        yield f"{name}: expected centimetres, found {values.max():.3g}"
    attributes[name] = values


def _guide_faults(curves: Curves, guide_ids: np.ndarray) -> Iterator[str]:
    """Closest guides are ids of guides in the file, with weights."""
    guides, weights = (curves.attributes.get(name) for name in ("groom_closest_guides", "groom_guide_weights"))
    if (guides is None) != (weights is None):
        yield f"{curves.name}: groom_closest_guides and groom_guide_weights need each other"
    if guides is not None and not np.isin(guides, guide_ids).all():
        yield f"{curves.name}: groom_closest_guides of curves that are no guides"
    if weights is not None and np.abs(weights.sum(axis=1) - 1).max() > WEIGHT_SLACK:
        yield f"{curves.name}: groom_guide_weights that do not sum to 1"


def _selector(schema: Any, frame: int) -> Any:
    """Of an integer the library makes a time, and takes the last sample before it."""
    return Abc.ISampleSelector(float(schema.getTimeSampling().getSampleTime(frame)))


def _is_guide(curves: Curves) -> bool:
    return "groom_guide" in curves.attributes and bool((curves.attributes["groom_guide"] == 1).all())


def _is_geometry(node: Any) -> bool:
    return any(kind.matches(node.getMetaData()) for kind in (AbcGeom.IXform, AbcGeom.ICurves))


def _children(node: Any) -> list[Any]:
    return [node.getChild(index) for index in range(node.getNumChildren())]


def _headers(properties: Any) -> list[Any]:
    return [properties.getPropertyHeader(index) for index in range(properties.getNumProperties())]


def main(paths: list[str]) -> int:
    """Print every fault. Returns 0 for files without one, else 1."""
    if not 1 <= len(paths) <= 2:
        print(__doc__)
        return 2
    results = [check(path, is_cache=index == 1) for index, path in enumerate(paths)]
    faults = [fault for result, _ in results for fault in result]
    if len(results) == 2:
        faults += check_pair(results[0][1], results[1][1])
    for (_, found), path in zip(results, paths):
        for curves in found:
            names = ", ".join(sorted(curves.attributes))
            print(f"{path}: {curves.name}: {len(curves.counts)} curves, {curves.frames} frames; {names}")
    print("\n".join(faults) or "no faults")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
