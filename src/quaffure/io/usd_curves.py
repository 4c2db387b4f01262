"""Curves of an OpenUSD file, read in a process of its own: `python -m quaffure.io.usd_curves FILE`.

The USD library ends the process, or fills its memory, on files of a few kilobytes: values, prims and paths that are
nested tens of thousands deep, and references that double with every level. No check of the file's text finds them all,
because one file may name others.
"""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, Work

from quaffure.errors import InputError, refused
from quaffure.geometry.axes import mean_scale
from quaffure.hair.curve_bases import (
    LINEAR,
    PERIODIC,
    closed_polylines,
    cubic_polylines,
    is_basis_valid,
    is_dense,
    nurbs_polylines,
    passes_its_points,
)
from quaffure.hair.resample import concatenate_strands
from quaffure.hair.strand_attributes import groups_of, per_point, per_strand
from quaffure.hair.strands import HELD_PARTS, TIE_VERTEX, Strands, checked_strands, checked_times, held_parts_of
from quaffure.io.held_parts import checked_held_parts
from quaffure.io.strand_process import serve, write_strands
from quaffure.io.usd_files import named_files
from quaffure.io.usd_process import PREFIX

COLOURS = ("groom_color", "displayColor")
ROOT_UVS = ("groom_root_uv", "st", "uv")
"""Primvars of colours and of texture coordinates at roots, the first that there is."""
GUIDE = "groom_guide"
"""Unreal's primvar of a curve: 1 for a guide."""


def main(path: Path) -> int:
    """Read a stage for the process that started this one."""
    Work.SetConcurrencyLimit(1)
    return serve(path, _read_stage, write_strands)


def _read_stage(path: Path) -> Strands:
    # On damaged files the USD library raises its own error, and returns values of unexpected types.
    with refused(path, "a USD file", Exception), _first_message():
        layers = named_files(path)  # none of which is a FIFO, and which stay open until the stage is
        stage = Usd.Stage.Open(str(path))
        layers.clear()
        curves, others = list[UsdGeom.Curves](), set[str]()
        for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
            if prim.IsA(UsdGeom.BasisCurves) or _is_nurbs(prim):
                curves.append(UsdGeom.Curves(prim))
            elif prim.IsA(UsdGeom.Boundable):
                others.add(str(prim.GetTypeName()))
        read = [(_with_attributes(_read_curves(curve, path), curve), _guides(curve)) for curve in _rendered(curves)]
        parts = [strands.select(~guides) for strands, guides in read if not guides.all()]
        parts = parts or [strands for strands, _ in read]
        if not parts:
            only = f", only {', '.join(sorted(others))}" if others else ""
            found = f"no strands: no curves{only}"
            raise InputError(path, "at least one strand, in BasisCurves or NurbsCurves", found)
        every = concatenate_strands(parts)
        named = every.attributes.with_groups_by_name()
        checked = checked_strands(every.points, every.counts, path, held_parts_of(every), named)
        samples = max((curve.GetPointsAttr().GetTimeSamples() for curve in _rendered(curves)), key=len)
        with np.errstate(all="ignore"):
            times = np.array(samples, dtype=np.float64) / stage.GetTimeCodesPerSecond()
        return replace(checked, times=checked_times(times, path))


def _rendered(curves: list[UsdGeom.Curves]) -> list[UsdGeom.Curves]:
    """The curves that a renderer shows; without any the proxies, without these the guides, and hidden ones at last."""
    visible = [curve for curve in curves if curve.ComputeVisibility(_time(curve)) != UsdGeom.Tokens.invisible]
    tokens = UsdGeom.Tokens
    for purposes in ((tokens.default_, tokens.render), (tokens.proxy,), (tokens.guide,)):
        chosen = [curve for curve in visible or curves if curve.ComputePurpose() in purposes]
        if chosen:
            return chosen
    return []


@contextmanager
def _first_message() -> Iterator[None]:
    """Raise, instead of the library's error with its places in the source, what it says."""
    from pxr import Tf

    try:
        yield
    except Tf.ErrorException as error:
        said = re.search(r" : '(.+?)'?$", str(error), re.MULTILINE)
        raise ValueError(said[1] if said else "a broken one") from error


def _time(curve: UsdGeom.Curves) -> Usd.TimeCode:
    """The first time of a curve's points."""
    samples = curve.GetPointsAttr().GetTimeSamples()
    return Usd.TimeCode(samples[0]) if samples else Usd.TimeCode.Default()


def _read_curves(curve: UsdGeom.Curves, path: Path) -> Strands:
    time = _time(curve)
    points = np.array(curve.GetPointsAttr().Get(time) or [], dtype=np.float64).reshape(-1, 3)
    counts = np.array(curve.GetCurveVertexCountsAttr().Get(time) or [], dtype=np.int64)
    if (counts < 0).any() or counts.sum() != len(points):
        raise InputError(path, f"{counts.sum()} points in {curve.GetPath()}", f"{len(points)}")
    # Row vectors, as in all of USD.
    world = np.array(curve.ComputeLocalToWorldTransform(time))
    points = points @ world[:3, :3] + world[3, :3]
    if _is_nurbs(curve.GetPrim()):
        return Strands(*_nurbs(UsdGeom.NurbsCurves(curve.GetPrim()), points, counts, time), str(path))
    curves = UsdGeom.BasisCurves(curve.GetPrim())
    basis, wrap = str(curves.GetBasisAttr().Get()), str(curves.GetWrapAttr().Get())
    # By default curves are cubic Beziers: polylines of programs that write no type mostly have another number of points
    # than these can have.
    is_linear = str(curves.GetTypeAttr().Get()) == LINEAR or not is_basis_valid(counts, basis, wrap)
    through_points = is_linear or passes_its_points(basis, wrap)
    parts = _read_held_parts(curve, counts, path) if through_points else {}
    if is_linear and wrap == PERIODIC:
        return Strands(*closed_polylines(points, counts), str(path))
    # Held parts are those of a drape's edges, each from a point to the next, however few.
    if is_linear or parts or (through_points and is_dense(counts)):
        return Strands(points, counts, str(path), **parts)
    return Strands(*cubic_polylines(points, counts, basis, wrap), str(path))


def _with_attributes(strands: Strands, curve: UsdGeom.Curves) -> Strands:
    """The strands with widths, colours, ids, root coordinates and groups; without groups of its own a prim is one."""
    time = _time(curve)
    counts = np.array(curve.GetCurveVertexCountsAttr().Get(time) or [], dtype=np.int64)
    api = UsdGeom.PrimvarsAPI(curve)

    widths = np.array(curve.GetWidthsAttr().Get(time) or [], dtype=np.float64)
    colours = next((found for name in COLOURS if len(found := _numbers(api, name, time, 3))), np.empty((0, 3)))
    uv = next((found for name in ROOT_UVS if len(found := _numbers(api, name, time, 2))), np.empty((0, 2)))
    identifier = per_strand(_numbers(api, "groom_id", time), counts)
    groups = per_strand(_numbers(api, "groom_group_id", time), counts)
    attributes = replace(
        groups_of(groups, _group_names(api, time, counts), len(counts), str(curve.GetPath())),
        width=per_point(widths, counts, strands.counts),
        colour=per_point(colours, counts, strands.counts),
        identifier=None if identifier is None else identifier.astype(np.int64),
        root_uv=per_strand(uv, counts),
    )
    world = np.array(curve.ComputeLocalToWorldTransform(time))[:3, :3]
    return replace(strands, attributes=attributes.scaled(mean_scale(world)))


def _numbers(api: UsdGeom.PrimvarsAPI, name: str, time: Usd.TimeCode, columns: int = 1) -> np.ndarray:
    """Numbers of a primvar, in rows of several columns; empty without it."""
    found = api.FindPrimvarWithInheritance(name)
    values = found.ComputeFlattened(time) if found.HasValue() else None
    array = np.array([] if values is None else values, dtype=np.float64, ndmin=1)
    return array.reshape(-1, columns) if columns > 1 and array.size % columns == 0 else array


def _guides(curve: UsdGeom.Curves) -> np.ndarray:
    """Whether each curve is a guide by Unreal's primvar, of each curve or of all of them."""
    time = _time(curve)
    counts = np.array(curve.GetCurveVertexCountsAttr().Get(time) or [], dtype=np.int64)
    guides = per_strand(_numbers(UsdGeom.PrimvarsAPI(curve), GUIDE, time) != 0, counts)
    return np.zeros(len(counts), bool) if guides is None else guides


def _group_names(api: UsdGeom.PrimvarsAPI, time: Usd.TimeCode, counts: np.ndarray) -> np.ndarray | None:
    """Name of every curve's group by Unreal's attribute."""
    found = api.FindPrimvarWithInheritance("groom_group_name")
    values = found.ComputeFlattened(time) if found.HasValue() else None
    if values is None:
        return None
    return per_strand(np.array([values] if isinstance(values, str) else [*values], dtype=str), counts)


def _is_nurbs(prim: Usd.Prim) -> bool:
    return bool(prim.IsA(UsdGeom.NurbsCurves))


def _nurbs(
    curves: UsdGeom.NurbsCurves, points: np.ndarray, counts: np.ndarray, time: Usd.TimeCode
) -> tuple[np.ndarray, np.ndarray]:
    orders = np.array(curves.GetOrderAttr().Get(time) or [], dtype=np.int64)
    knots = np.array(curves.GetKnotsAttr().Get(time) or [], dtype=np.float64)
    weights = curves.GetPointWeightsAttr().Get(time) if hasattr(curves, "GetPointWeightsAttr") else None
    weights = None if weights is None else np.array(weights, dtype=np.float64)
    return nurbs_polylines(points, counts, orders, knots, weights, str(curves.GetPath()))


def _read_held_parts(curve: UsdGeom.Curves, counts: np.ndarray, path: Path) -> dict[str, Any]:
    """Per-vertex values of edges, repeated where a curve has one for all of its edges."""
    found: dict[str, np.ndarray] = {}
    primvars = UsdGeom.PrimvarsAPI(curve)
    for name in HELD_PARTS:
        if not primvars.HasPrimvar(PREFIX + name):
            continue
        array = np.array(primvars.GetPrimvar(PREFIX + name).ComputeFlattened(Usd.TimeCode.EarliestTime()))
        if name != TIE_VERTEX and len(array) == len(counts):
            array = np.repeat(array, counts)
        expected = len(counts) if name == TIE_VERTEX else int(counts.sum())
        if array.shape != (expected,):
            raise InputError(path, f"{expected} values of primvars:{PREFIX}{name}", f"{array.shape}")
        found[name] = array
    return checked_held_parts(found, counts, path)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
