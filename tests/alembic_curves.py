"""Alembic files of curves for tests."""

from pathlib import Path
from typing import Any

import numpy as np
from alembic3d import Abc, AbcGeom
from imath import IntArray, StringArray, V3d, V3fArray


def write_curves(path: Path, objects: dict[str, dict[str, Any]]) -> None:
    """Write an archive.

    Args:
        objects: by name, `points` [P,3] and `counts` of each; and `basis`, the `move` of its transform, `frames` in
            which its points fall, whether it is `hidden`, the `tool` of its transform, `guide` of each curve, and other
            `integers` and `texts` of each, or one of all, by name.
    """
    archive = Abc.OArchive(str(path))
    for name, curves in objects.items():
        node = AbcGeom.OXform(archive.getTop(), name)
        move = AbcGeom.XformSample()
        move.setTranslation(V3d(*curves.get("move", (0, 0, 0))))
        node.getSchema().set(move)
        if "tool" in curves:
            Abc.OStringProperty(node.getSchema().getUserProperties(), "groom_tool").setValue(curves["tool"])
        if curves.get("hidden"):
            visibility = AbcGeom.CreateVisibilityProperty(node, 0)
            visibility.setValue(int(AbcGeom.ObjectVisibility.kVisibilityHidden))
        schema = AbcGeom.OCurves(node, "curves").getSchema()
        for frame in range(curves.get("frames", 1)):
            schema.set(_sample(curves["points"] - [0, 0, frame], curves["counts"], curves.get("basis")))
        scope = AbcGeom.GeometryScope.kUniformScope
        integers = curves.get("integers", {}) | ({"groom_guide": curves["guide"]} if "guide" in curves else {})
        for attribute, values in integers.items():
            parameter = AbcGeom.OInt32GeomParam(schema.getArbGeomParams(), attribute, False, scope, 1)
            parameter.set(AbcGeom.OInt32GeomParamSample(_integers(values), scope))
        for attribute, texts in curves.get("texts", {}).items():
            own = scope if len(texts) == len(curves["counts"]) else AbcGeom.GeometryScope.kConstantScope
            text_parameter = AbcGeom.OStringGeomParam(schema.getArbGeomParams(), attribute, False, own, 1)
            array = StringArray(texts[0], len(texts))
            for index, text in enumerate(texts):
                array[index] = text
            text_parameter.set(AbcGeom.OStringGeomParamSample(array, own))


def _sample(points: np.ndarray, counts: list[int], basis: str | None) -> Any:
    array = V3fArray(len(points))
    for index, point in enumerate(points.tolist()):
        array[index] = tuple(point)
    kind = AbcGeom.CurveType.kLinear if basis is None else AbcGeom.CurveType.kCubic
    named = getattr(AbcGeom.BasisType, basis or "kNoBasis")
    return AbcGeom.OCurvesSchemaSample(
        array,
        _integers(counts),
        kind,
        AbcGeom.CurvePeriodicity.kNonPeriodic,
        AbcGeom.OFloatGeomParamSample(),
        AbcGeom.OV2fGeomParamSample(),
        AbcGeom.ON3fGeomParamSample(),
        named,
    )


def _integers(numbers: list[int]) -> IntArray:
    array = IntArray(len(numbers))
    for index, number in enumerate(numbers):
        array[index] = number
    return array
