"""Curves of an Alembic file, read in a process of its own: `python -m quaffure.io.alembic_curves FILE`."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from alembic3d import Abc, AbcGeom

from quaffure.errors import InputError, refused
from quaffure.geometry.axes import mean_scale
from quaffure.hair.curve_bases import (
    BEZIER,
    BSPLINE,
    CATMULL_ROM,
    NONPERIODIC,
    PERIODIC,
    closed_polylines,
    cubic_polylines,
    is_basis_valid,
    nurbs_polylines,
)
from quaffure.hair.resample import concatenate_strands
from quaffure.hair.strand_attributes import StrandAttributes, groups_of, per_point, per_strand
from quaffure.hair.strands import Strands, checked_strands, checked_times
from quaffure.io.alembic_process import TOOL_PROPERTY, WRITER
from quaffure.io.strand_process import serve, write_strands

BASES = {
    AbcGeom.BasisType.kBezierBasis: BEZIER,
    AbcGeom.BasisType.kBsplineBasis: BSPLINE,
    AbcGeom.BasisType.kCatmullromBasis: CATMULL_ROM,
}
GUIDE = "groom_guide"
"""Unreal's attribute of a curve: 1 for a guide."""
DRAPE_FROM_UNREAL = np.diag([1.0, -1.0, 1.0, 1.0])
"""From the axes in which `quaffure.io.alembic_groom` writes to those of the drape, but for the unit."""
MOST_OBJECTS = 100_000


class _Object(NamedTuple):
    """An object of the archive.

    Attributes:
        world: from its own space to the archive's, right-handed if this package wrote it; for row vectors.
        hidden: whether it or one above it is.
    """

    handle: Any
    world: np.ndarray
    hidden: bool


def main(path: Path) -> int:
    """Read an archive for the process that started this one."""
    return serve(path, _read_archive, write_strands)


def _read_archive(path: Path) -> Strands:
    # On damaged files the library raises errors of several types.
    with refused(path, "an Alembic file", Exception):
        archive = Abc.IArchive(str(path))
        objects = list(_objects(archive))
        curves = [found for found in objects if AbcGeom.ICurves.matches(found.handle.getHeader())]
        visible = [found for found in curves if not found.hidden] or curves
        read = [_read_curves(found, path) for found in visible]
        parts = [strands.select(~guides) for strands, guides in read if not guides.all()]
        parts = parts or [strands for strands, _ in read if len(strands)]
        if not parts:
            schemas = {found.handle.getMetaData().get("schema") for found in objects}
            kinds = ", ".join(sorted(schema for schema in schemas if schema)) or "nothing"
            raise InputError(path, "at least one strand, in curves", f"no strands: no curves, only {kinds}")
        every = concatenate_strands(parts)
        named = every.attributes.with_groups_by_name()
        checked = checked_strands(every.points, every.counts, path, attributes=named)
        return replace(checked, times=checked_times(max(map(_times, visible), key=len), path))


def _objects(archive: Any) -> Iterator[_Object]:
    """All objects, parents first. A loop with a stack, so that a file nested ten thousand deep is no trap."""
    stack = [_Object(archive.getTop(), np.eye(4), False)]
    count = 0
    while stack:
        parent = stack.pop()
        yield parent
        count += parent.handle.getNumChildren()
        if count > MOST_OBJECTS:
            raise InputError(archive.getName(), f"at most {MOST_OBJECTS} objects", "more")
        children = [parent.handle.getChild(index) for index in range(parent.handle.getNumChildren())]
        stack += [_Object(child, _world(child, parent), _is_hidden(child, parent)) for child in reversed(children)]


def _world(child: Any, parent: _Object) -> np.ndarray:
    if not AbcGeom.IXform.matches(child.getHeader()):
        return parent.world
    schema = AbcGeom.IXform(child.getParent(), child.getName()).getSchema()
    sample = schema.getValue()
    matrix = sample.getMatrix()
    own = np.array([[matrix[row][column] for column in range(4)] for row in range(4)])
    world = own @ parent.world if sample.getInheritsXforms() else own
    return DRAPE_FROM_UNREAL @ world if _is_ours(schema) else world


def _is_ours(schema: Any) -> bool:
    """Whether a node is the topmost one of a groom that any version of this package wrote."""
    properties = schema.getUserProperties()
    header = properties.getPropertyHeader(TOOL_PROPERTY) if properties.valid() else None
    if header is None or not Abc.IStringProperty.matches(header):
        return False
    tool = Abc.IStringProperty(properties, TOOL_PROPERTY)
    return tool.getNumSamples() > 0 and str(tool.getValue()).split()[:1] == [WRITER]


def _is_hidden(child: Any, parent: _Object) -> bool:
    visibility = AbcGeom.GetVisibility(child)
    if visibility == AbcGeom.ObjectVisibility.kVisibilityDeferred:
        return parent.hidden
    return bool(visibility == AbcGeom.ObjectVisibility.kVisibilityHidden)


def _read_curves(found: _Object, path: Path) -> tuple[Strands, np.ndarray]:
    """The curves of an object, and which of them are guides."""
    name = found.handle.getFullName()
    schema = AbcGeom.ICurves(found.handle.getParent(), found.handle.getName()).getSchema()
    if schema.getNumSamples() < 1:
        return Strands(np.empty((0, 3)), np.empty(0, np.int64), str(path)), np.empty(0, bool)
    sample = schema.getValue()
    points = np.array(sample.getPositions(), dtype=np.float64).reshape(-1, 3)
    counts = np.array(sample.getCurvesNumVertices(), dtype=np.int64)
    if (counts < 0).any() or counts.sum() != len(points):
        raise InputError(path, f"{counts.sum()} points in {name}", f"{len(points)}")
    points = points @ found.world[:3, :3] + found.world[3, :3]
    polylines, lengths = _polylines(sample, points, counts, name)
    attributes = _attributes(schema, counts, lengths, name).scaled(mean_scale(found.world[:3, :3]))
    return Strands(polylines, lengths, str(path), attributes=attributes), _guides(schema, len(counts))


def _times(found: _Object) -> np.ndarray:
    """Times of the samples of curves [s]."""
    schema = AbcGeom.ICurves(found.handle.getParent(), found.handle.getName()).getSchema()
    sampling = schema.getTimeSampling()
    return np.array([sampling.getSampleTime(index) for index in range(schema.getNumSamples())], dtype=np.float64)


def _polylines(sample: Any, points: np.ndarray, counts: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    kind, wrap = sample.getType(), PERIODIC if sample.getWrap() == AbcGeom.CurvePeriodicity.kPeriodic else NONPERIODIC
    if kind == AbcGeom.CurveType.kVariableOrder:
        orders, knots, weights = (
            np.array(values if values else [], dtype=kind)
            for values, kind in (
                (sample.getOrders(), np.int64),
                (sample.getKnots(), np.float64),
                (sample.getPositionWeights(), np.float64),
            )
        )
        return nurbs_polylines(points, counts, orders, knots, weights, name)
    basis = BASES.get(sample.getBasis(), "")
    # Cubic curves without a basis are polylines of programs that know no other type.
    if kind == AbcGeom.CurveType.kCubic and is_basis_valid(counts, basis, wrap):
        return cubic_polylines(points, counts, basis, wrap)
    return closed_polylines(points, counts) if wrap == PERIODIC else (points, counts)


def _attributes(schema: Any, counts: np.ndarray, points: np.ndarray, name: str) -> StrandAttributes:
    """By Unreal's names; widths of the curves themselves, too. Without groups of its own each object is one."""
    widths = _values(schema, "groom_width", AbcGeom.IFloatGeomParam)
    if not len(widths) and schema.getWidthsParam() and schema.getWidthsParam().valid():
        widths = np.array(schema.getWidthsParam().getExpandedValue().getVals(), dtype=np.float64)
    colours = _values(schema, "groom_color", AbcGeom.IV3fGeomParam, AbcGeom.IC3fGeomParam).reshape(-1, 3)
    identifier = per_strand(_values(schema, "groom_id", AbcGeom.IInt32GeomParam), counts)
    groups = per_strand(_values(schema, "groom_group_id", AbcGeom.IInt32GeomParam), counts)
    names = per_strand(_texts(schema, "groom_group_name", len(counts)), counts)
    return replace(
        groups_of(groups, names, len(counts), name),
        width=per_point(widths, counts, points),
        colour=per_point(colours, counts, points),
        identifier=None if identifier is None else identifier.astype(np.int64),
        root_uv=per_strand(_values(schema, "groom_root_uv", AbcGeom.IV2fGeomParam).reshape(-1, 2), counts),
    )


def _values(schema: Any, name: str, *kinds: Any) -> np.ndarray:
    """Numbers of a parameter of one of these kinds; empty without it."""
    parameters = schema.getArbGeomParams()
    header = parameters.getPropertyHeader(name) if parameters.valid() else None
    for kind in kinds:
        if header is not None and kind.matches(header):
            return np.array(kind(parameters, name).getExpandedValue().getVals(), dtype=np.float64)
    return np.empty(0)


def _texts(schema: Any, name: str, count: int) -> np.ndarray:
    """Texts of a parameter; empty without it, and where it has neither one nor `count` of them."""
    parameters = schema.getArbGeomParams()
    header = parameters.getPropertyHeader(name) if parameters.valid() else None
    if header is None or not AbcGeom.IStringGeomParam.matches(header):
        return np.empty(0, dtype=str)
    texts = AbcGeom.IStringGeomParam(parameters, name).getExpandedValue().getVals()
    # A damaged file of a few kilobytes may have millions of them, of which Python makes an object each.
    return np.array([*texts] if len(texts) in (1, count) else [], dtype=str)


def _guides(schema: Any, count: int) -> np.ndarray:
    """Whether each curve is a guide by Unreal's attribute, of each curve or of all of them."""
    values = _values(schema, GUIDE, AbcGeom.IInt32GeomParam, AbcGeom.IInt16GeomParam, AbcGeom.IBooleanGeomParam)
    guides = per_strand(values != 0, np.ones(count, np.int64))
    return np.zeros(count, bool) if guides is None else guides


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
