"""Curves of an OpenUSD file, read in a process of its own: `python -m quaffure.io.usd_curves FILE`.

The USD library ends the process, or fills its memory, on files of a few kilobytes: values, prims and paths that are
nested tens of thousands deep, and references that double with every level. No check of the file's text finds them all,
because one file may name others.
"""

import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from pxr import Usd, UsdGeom, Work

from quaffure.errors import InputError, refused
from quaffure.hair.resample import concatenate_strands
from quaffure.hair.strands import HELD_PARTS, TIE_VERTEX, Strands, checked_strands, held_parts_of
from quaffure.io.held_parts import checked_held_parts
from quaffure.io.usd_process import BYTES_PER_BYTE, FREE_BYTES, FREE_SECONDS, PREFIX, REFUSED, SECONDS_PER_BYTE


def main(path: Path) -> int:
    """Write the curves of a stage to the standard output as `.npz`, or as JSON what was expected and what was found.

    Returns:
        0, or `REFUSED`.
    """
    Work.SetConcurrencyLimit(1)
    with _results() as output:
        _limit_this_process(path.stat().st_size)
        try:
            strands = _read_stage(path)
        except InputError as error:
            output.write(json.dumps([error.expected, error.found]).encode())
            return REFUSED
        np.savez(output, points=strands.points, counts=strands.counts, **held_parts_of(strands))
    return 0


@contextmanager
def _results() -> Iterator[BinaryIO]:
    """The standard output; what the USD library prints there goes to the error stream."""
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)
        yield output


def _limit_this_process(file_size: int) -> None:
    """Limit memory and processor time to what a stage of this size [bytes] may need, where the system can."""
    try:
        import resource
    except ImportError:
        return
    memory = FREE_BYTES + BYTES_PER_BYTE * file_size
    seconds = round(FREE_SECONDS + SECONDS_PER_BYTE * file_size)
    for limit, value in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
    ):
        _, most = resource.getrlimit(limit)
        resource.setrlimit(limit, (value if most == resource.RLIM_INFINITY else min(value, most), most))


def _read_stage(path: Path) -> Strands:
    # On damaged files the USD library raises its own error, and returns values of unexpected types.
    with refused(path, "a USD file", Exception), _first_message():
        stage = Usd.Stage.Open(str(path))
        curves = [UsdGeom.Curves(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.BasisCurves)]
        rendered = [curve for curve in curves if curve.ComputePurpose() != UsdGeom.Tokens.guide]
        parts = [_read_curves(curve, path) for curve in rendered or curves]
        if not parts:
            raise InputError(path, "at least one strand", "no strands: no curves")
        every = concatenate_strands(parts)
        return checked_strands(every.points, every.counts, path, held_parts_of(every))


@contextmanager
def _first_message() -> Iterator[None]:
    """Raise, instead of the library's error with its places in the source, what it says."""
    from pxr import Tf

    try:
        yield
    except Tf.ErrorException as error:
        said = re.search(r" : '(.+?)'?$", str(error), re.MULTILINE)
        raise ValueError(said[1] if said else "a broken one") from error


def _read_curves(curve: UsdGeom.Curves, path: Path) -> Strands:
    samples = curve.GetPointsAttr().GetTimeSamples()
    time = Usd.TimeCode(samples[0]) if samples else Usd.TimeCode.Default()
    points = np.array(curve.GetPointsAttr().Get(time) or [], dtype=np.float64).reshape(-1, 3)
    counts = np.array(curve.GetCurveVertexCountsAttr().Get(time) or [], dtype=np.int64)
    if (counts < 0).any() or counts.sum() != len(points):
        raise InputError(path, f"{counts.sum()} points in {curve.GetPath()}", f"{len(points)}")
    # Row vectors, as in all of USD.
    world = np.array(curve.ComputeLocalToWorldTransform(time))
    return Strands(points @ world[:3, :3] + world[3, :3], counts, str(path), **_read_held_parts(curve, counts, path))


def _read_held_parts(curve: UsdGeom.Curves, counts: np.ndarray, path: Path) -> dict[str, np.ndarray]:
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
