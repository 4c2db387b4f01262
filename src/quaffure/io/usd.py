"""OpenUSD: a drape, as animated curves on an animated body.

The layout follows what hair tools expect. Blender makes hair curves of every `BasisCurves`; Unreal makes a groom of
all curves below a prim with `GroomAPI` and reads the `groom_*` primvars of its Alembic convention, where `groom_guide`
is 1 for simulation guides and 0 for rendered strands; guides alone would show no hair. So the strands are written
once as strands, and a few of them once more as guides, with the purpose `guide` that viewers hide.
"""

import re
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from quaffure.errors import InputError
from quaffure.geometry.sampling import spread_subset
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.strands import TIE_VERTEX, held_parts_of
from quaffure.io.atomic import replacing
from quaffure.io.usd_process import PREFIX

USD_SUFFIXES = (".usd", ".usda", ".usdc")
STRAND_WIDTH = 1.0e-4  # m: a real hair, a little thickened; tapers to its tip
# Hsu et al. 2024 interpolate a full head from 128 guides.
MOST_GUIDES = 128
HAIR_COLOUR, BODY_COLOUR = (0.15, 0.062, 0.025), (0.62, 0.50, 0.435)


def write_usd(path: Path, seq: DrapeSequence) -> None:
    """Write the drape as a stage: z up, metres, one time code a frame from 0 on.

    `/Drape/Body` is a mesh, `/Drape/Hair/Strands` and `/Drape/Hair/Guides` are curves through the strands' vertices
    (pinned Catmull-Rom, so that no vertex is added). `primvars:rest` holds the posed strands of the first frame.

    Raises:
        InputError: another suffix than .usd (binary), .usda or .usdc, or not writable.
    """
    if path.suffix.lower() not in USD_SUFFIXES:
        raise InputError(path, f"a name ending in {', '.join(USD_SUFFIXES)}", f"{path.suffix or 'no suffix'}")
    with replacing(path) as temporary:
        stage = Usd.Stage.CreateInMemory()
        _set_stage(stage, seq)
        _add_body(stage, seq)
        hair = UsdGeom.Xform.Define(stage, "/Drape/Hair").GetPrim()
        hair.AddAppliedSchema("GroomAPI")
        every = np.arange(seq.strands.shape[1])
        _add_curves(stage, "/Drape/Hair/Strands", seq, every, guide=False)
        _add_curves(stage, "/Drape/Hair/Guides", seq, spread_subset(seq.posed[0, :, 0], MOST_GUIDES), guide=True)
        _export(stage, temporary)


def _export(stage: Usd.Stage, path: Path) -> None:
    """Write a stage.

    Raises:
        OSError: it cannot be written.
    """
    try:
        written = stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:
        said = re.search(r"writing file: (.+?)'", str(error))
        raise OSError(said[1] if said else "USD could not write it") from error
    if not written:
        raise OSError("USD could not write it")


def _set_stage(stage: Usd.Stage, seq: DrapeSequence) -> None:
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    stage.SetTimeCodesPerSecond(seq.fps)
    stage.SetFramesPerSecond(seq.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(seq) - 1)
    root = UsdGeom.Xform.Define(stage, "/Drape").GetPrim()
    Usd.ModelAPI(root).SetKind("component")
    stage.SetDefaultPrim(root)
    stage.GetRootLayer().documentation = "Hair draped by quaffure"


def _add_body(stage: Usd.Stage, seq: DrapeSequence) -> None:
    mesh = UsdGeom.Mesh.Define(stage, "/Drape/Body")
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(seq.body_faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(seq.body_faces.reshape(-1))))
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set([Gf.Vec3f(*BODY_COLOUR)])
    _animate(mesh, seq.body_vertices, margin=0.0)


def _add_curves(stage: Usd.Stage, name: str, seq: DrapeSequence, chosen: np.ndarray, guide: bool) -> None:
    curves = UsdGeom.BasisCurves.Define(stage, name)
    curves.CreateTypeAttr(UsdGeom.Tokens.cubic)
    curves.CreateBasisAttr(UsdGeom.Tokens.catmullRom)
    curves.CreateWrapAttr(UsdGeom.Tokens.pinned)
    vertices = seq.strands.shape[2]
    curves.CreateCurveVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(chosen), vertices, np.int32)))
    taper = STRAND_WIDTH * np.linspace(1.0, 0.35, vertices, dtype=np.float32)
    curves.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.tile(taper, len(chosen))))
    curves.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    curves.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set([Gf.Vec3f(*HAIR_COLOUR)])
    if guide:
        curves.CreatePurposeAttr(UsdGeom.Tokens.guide)
    primvars = UsdGeom.PrimvarsAPI(curves)
    for attribute, values in (
        ("groom_id", chosen),
        ("groom_guide", np.full(len(chosen), guide)),
        ("groom_group_id", np.zeros(len(chosen))),
    ):
        primvar = primvars.CreatePrimvar(attribute, Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.uniform)
        primvar.Set(Vt.IntArray.FromNumpy(values.astype(np.int32)))
    _add_held_parts(primvars, seq, chosen)
    rest = primvars.CreatePrimvar("rest", Sdf.ValueTypeNames.Point3fArray, UsdGeom.Tokens.vertex)
    rest.Set(_points(seq.posed[0, chosen]))
    _animate(curves, seq.strands[:, chosen], margin=STRAND_WIDTH)


def _add_held_parts(primvars: UsdGeom.PrimvarsAPI, seq: DrapeSequence, chosen: np.ndarray) -> None:
    """Values of edges at their first vertices; the tip repeats the last edge."""
    for name, values in held_parts_of(seq).items():
        if name == TIE_VERTEX:
            primvar = primvars.CreatePrimvar(PREFIX + name, Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.uniform)
            primvar.Set(Vt.IntArray.FromNumpy(values[chosen].astype(np.int32)))
        else:
            primvar = primvars.CreatePrimvar(PREFIX + name, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex)
            at_vertices = np.pad(values[chosen], ((0, 0), (0, 1)), mode="edge")
            primvar.Set(Vt.FloatArray.FromNumpy(at_vertices.ravel().astype(np.float32)))


def _animate(gprim: UsdGeom.PointBased, positions: np.ndarray, margin: float) -> None:
    points, extent = gprim.CreatePointsAttr(), gprim.CreateExtentAttr()
    for frame, vertices in enumerate(positions):
        flat = vertices.reshape(-1, 3)
        points.Set(_points(flat), frame)
        extent.Set(_points(np.stack([flat.min(axis=0) - margin, flat.max(axis=0) + margin])), frame)


def _points(positions: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(positions.reshape(-1, 3), dtype=np.float32))
