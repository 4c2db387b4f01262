"""Curves into an Alembic archive, in a process of its own: `python -m quaffure.io.alembic_archive FILE < ARRAYS`.

The Alembic library ends the process where it cannot write, on a full disk for instance. The standard input holds
arrays, one after another, each as numpy saves it: first a description, as JSON in a string (`Description`); then, of
all curves in its order, how many points each has and the attributes; then the points of all curves of the first frame,
of the second, and so on.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypedDict

import numpy as np
from alembic3d import Abc, AbcCoreAbstract, AbcGeom
from imath import (
    FloatArrayFromBuffer,
    IntArrayFromBuffer,
    StringArray,
    V2fArrayFromBuffer,
    V3fArrayFromBuffer,
    V3iArrayFromBuffer,
)

FAILED = 3
"""Exit code where the file is not what was written."""
CURVES = "curves"
WIDTH = "groom_width"
"""The attribute that is the curves' width, too, for programs that do not know it."""


class AttributeDescription(TypedDict):
    """Name, kind (a key of `KINDS`, or `text`) and scope (`uniform` or `vertex`) of an attribute."""

    name: str
    kind: str
    scope: str


class CurvesDescription(TypedDict):
    """Name of an object, and the attributes of its curves."""

    name: str
    attributes: list[AttributeDescription]


class Description(TypedDict):
    """What an archive holds but numbers.

    Keys:
        rate: frames per second.
        start: time of the first frame [s].
        tool: name and version of the program.
        about: of the archive, without ; and =, on which the library ends the process.
        top: name of the topmost node.
        integers, texts: its properties.
    """

    rate: float
    start: float
    tool: str
    about: str
    top: str
    integers: dict[str, int]
    texts: dict[str, str]
    curves: list[CurvesDescription]


class _Kind(NamedTuple):
    parameter: Any
    sample: Any
    array: Any
    dtype: str


KINDS = {
    "int": _Kind(AbcGeom.OInt32GeomParam, AbcGeom.OInt32GeomParamSample, IntArrayFromBuffer, "i4"),
    "int3": _Kind(AbcGeom.OV3iGeomParam, AbcGeom.OV3iGeomParamSample, V3iArrayFromBuffer, "i4"),
    "float": _Kind(AbcGeom.OFloatGeomParam, AbcGeom.OFloatGeomParamSample, FloatArrayFromBuffer, "f4"),
    "float2": _Kind(AbcGeom.OV2fGeomParam, AbcGeom.OV2fGeomParamSample, V2fArrayFromBuffer, "f4"),
    "float3": _Kind(AbcGeom.OV3fGeomParam, AbcGeom.OV3fGeomParamSample, V3fArrayFromBuffer, "f4"),
}
SCOPES = {"uniform": AbcGeom.GeometryScope.kUniformScope, "vertex": AbcGeom.GeometryScope.kVertexScope}


def main(path: Path) -> int:
    """Write an archive.

    Returns:
        0, or `FAILED`.
    """
    arrays = _arrays(sys.stdin.buffer)
    description: Description = json.loads(str(next(arrays)))
    last = _write(path, description, arrays)
    return 0 if _holds(path, description, last) else FAILED


def _arrays(stream: BinaryIO) -> Iterator[np.ndarray]:
    while stream.peek(1):  # type: ignore[attr-defined]  # the standard input is buffered
        yield np.lib.format.read_array(_Reader(stream), allow_pickle=False)


class _Reader:
    """Numpy asks a file for its position, which a pipe does not have."""

    def __init__(self, stream: BinaryIO) -> None:
        self.read = stream.read


def _write(path: Path, description: Description, arrays: Iterator[np.ndarray]) -> np.ndarray:
    """Returns:
    The points of the last curves in the last frame.
    """
    rate = description["rate"]
    archive = Abc.CreateArchiveWithInfo(str(path), rate, description["tool"], description["about"])
    sampling = archive.addTimeSampling(AbcCoreAbstract.TimeSampling(1.0 / rate, description["start"]))
    top = AbcGeom.OXform(archive.getTop(), description["top"])
    properties = top.getSchema().getUserProperties()
    for name, number in description["integers"].items():
        Abc.OInt16Property(properties, name).setValue(number)
    for name, text in description["texts"].items():
        Abc.OStringProperty(properties, name).setValue(text)
    every = [_Curves(top, curves, sampling, arrays) for curves in description["curves"]]
    points = np.empty(0)
    while True:
        for curves in every:
            found = next(arrays, None)
            if found is None:
                return points
            points = found
            curves.add_frame(points)


class _Curves:
    """Curves of an archive, whose attributes are constant and whose points have a sample a frame."""

    def __init__(
        self, parent: Any, description: CurvesDescription, sampling: int, attributes: Iterator[np.ndarray]
    ) -> None:
        # Blender and Maya show the name of the transform above the curves.
        node = AbcGeom.OXform(parent, description["name"])
        self._schema = AbcGeom.OCurves(node, CURVES, sampling).getSchema()
        self._counts = next(attributes)
        self._width = AbcGeom.OFloatGeomParamSample()
        for attribute in description["attributes"]:
            self._add(attribute, next(attributes))

    def _add(self, attribute: AttributeDescription, values: np.ndarray) -> None:
        parameters, scope = self._schema.getArbGeomParams(), SCOPES[attribute["scope"]]
        if attribute["kind"] == "text":
            parameter = AbcGeom.OStringGeomParam(parameters, attribute["name"], False, scope, 1)
            parameter.set(AbcGeom.OStringGeomParamSample(_texts(values), scope))
            return
        kind = KINDS[attribute["kind"]]
        sample = kind.sample(kind.array(np.ascontiguousarray(values, kind.dtype)), scope)
        kind.parameter(parameters, attribute["name"], False, scope, 1).set(sample)
        if attribute["name"] == WIDTH:
            self._width = sample

    def add_frame(self, points: np.ndarray) -> None:
        sample = AbcGeom.OCurvesSchemaSample(
            V3fArrayFromBuffer(points),
            IntArrayFromBuffer(self._counts),
            # Any basis but none makes Blender draw Bezier curves through the points.
            AbcGeom.CurveType.kLinear,
            AbcGeom.CurvePeriodicity.kNonPeriodic,
            self._width,
            AbcGeom.OV2fGeomParamSample(),
            AbcGeom.ON3fGeomParamSample(),
            AbcGeom.BasisType.kNoBasis,
        )
        self._schema.set(sample)


def _texts(values: np.ndarray) -> Any:
    array = StringArray(str(values[0]), len(values))
    for index in (values != values[0]).nonzero()[0].tolist():
        array[index] = str(values[index])
    return array


def _holds(path: Path, description: Description, last: np.ndarray) -> bool:
    """Whether the last sample of a file is what was written: not every failure ends the process."""
    top = Abc.IArchive(str(path)).getTop().getChild(description["top"])
    schema = AbcGeom.ICurves(top.getChild(description["curves"][-1]["name"]), CURVES).getSchema()
    # Of an integer the library makes a time.
    time = schema.getTimeSampling().getSampleTime(schema.getNumSamples() - 1)
    sample = schema.getValue(Abc.ISampleSelector(time))
    return bool(np.array_equal(np.array(sample.getPositions(), np.float32), last))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
