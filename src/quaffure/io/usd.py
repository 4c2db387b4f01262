"""OpenUSD: a drape, as animated curves on an animated body.

The layout follows what hair tools expect. Blender makes hair curves of every `BasisCurves`; Unreal makes a groom of
all curves below a prim with `GroomAPI`, reads the `groom_*` primvars of its Alembic convention, where `groom_guide`
is 1 for simulation guides and 0 for rendered strands, and binds it to the mesh with `GroomBindingAPI`. Guides alone
would show no hair. So the strands are written as strands, and on request guides once more, with the purpose `guide`
that viewers hide.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.export_clip import BODY_COLOUR, HAIR_COLOUR, ExportClip
from quaffure.hair.strands import TIE_VERTEX
from quaffure.io.atomic import replacing_together
from quaffure.io.output_path import check_suffix
from quaffure.io.usd_layers import FrameLayer, frame_layers
from quaffure.io.usd_materials import add_materials, bind_material
from quaffure.io.usd_process import PREFIX

USD_SUFFIXES = (".usd", ".usda", ".usdc")
ROOT, BODY, HAIR, STRANDS, GUIDES = "/Drape", "/Drape/Body", "/Drape/Hair", "/Drape/Hair/Strands", "/Drape/Hair/Guides"
BINDING = "unreal:groomBinding:groom"
UNSAVED_BYTES = 64e6
"""Frames in memory until they are written. A text file is kept whole."""


def write_usd(
    path: str | Path, drape: DrapeSequence | ExportClip, on_frame: Callable[[], object] = lambda: None
) -> None:
    """Write the drape as a stage: z up, metres, time codes that count the frames of the drape, at its rate. In a
    character's scene it is y up, and the body is the character's skin.

    `/Drape/Body` is a mesh, `/Drape/Hair/Strands` and `/Drape/Hair/Guides` are curves through the strands' vertices
    (pinned Catmull-Rom, so that no vertex is added). `primvars:rest` holds the strands at rest, or where the clip has
    no binding the posed strands of the first frame. Memory does not grow with the number of frames, but in .usda. With
    `frames_per_layer` frames are in layers beside the file, its value clips, which replace files of their names.

    Args:
        on_frame: called after each frame.

    Raises:
        InputError: another suffix than .usd (binary), .usda or .usdc, or not writable.
    """
    path = Path(path)
    check_suffix(path, *USD_SUFFIXES)
    clip = drape if isinstance(drape, ExportClip) else ExportClip(drape)
    per_layer = clip.settings.frames_per_layer
    layers = [] if per_layer is None else frame_layers(path, clip.frames, per_layer)
    with replacing_together(path, *(layer.path for layer in layers)) as (temporary, *parts), _system_errors():
        stage = _new_stage(temporary)
        _set_stage(stage, clip, clip.frames)
        root = UsdGeom.Xform.Define(stage, ROOT).GetPrim()
        Usd.ModelAPI(root).SetKind("component")
        add_materials(stage, f"{ROOT}/Materials", clip.has_colours)
        _add_body(stage, clip)
        hair = UsdGeom.Xform.Define(stage, HAIR).GetPrim()
        hair.AddAppliedSchema("GroomAPI")
        _Curves(stage, STRANDS, clip, is_guide=False).describe()
        if clip.settings.guides:
            _Curves(stage, GUIDES, clip, is_guide=True).describe()
        if layers:
            _animate_layers(stage, clip, dict(zip(parts, layers)), on_frame)
        else:
            _animate(stage, clip, clip.frames, on_frame)


@contextmanager
def _system_errors() -> Iterator[None]:
    """Raise errors of the library as an `OSError` that holds what the system said."""
    try:
        yield
    except Tf.ErrorException as error:
        said = re.search(r"writing file: (.+?)'", str(error))
        raise OSError(said[1] if said else "USD could not write it") from error


def _set_stage(stage: Usd.Stage, clip: ExportClip, frames: Sequence[int]) -> None:
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if clip.up_axis == "z" else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    stage.SetTimeCodesPerSecond(clip.sequence.fps)
    stage.SetFramesPerSecond(clip.sequence.fps)
    stage.SetStartTimeCode(_time_code(clip, frames[0]))
    stage.SetEndTimeCode(_time_code(clip, frames[-1]))
    stage.SetDefaultPrim(stage.OverridePrim(ROOT))
    stage.GetRootLayer().documentation = "Hair draped by quaffure"


def _add_body(stage: Usd.Stage, clip: ExportClip) -> None:
    faces = clip.body_faces
    mesh = UsdGeom.Mesh.Define(stage, BODY)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1))))
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set([BODY_COLOUR])
    if clip.body_uv is not None:
        texture = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
        )
        texture.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(clip.body_uv.reshape(-1, 2))))
    prim = mesh.GetPrim()
    bind_material(prim, f"{ROOT}/Materials/Body")
    prim.AddAppliedSchema("GroomBindingAPI")
    prim.CreateRelationship(BINDING, custom=False).SetTargets([HAIR])


class _Curves:
    """Strands or guides of a stage."""

    def __init__(self, stage: Usd.Stage, name: str, clip: ExportClip, is_guide: bool) -> None:
        self.curves, self.clip, self.is_guide = UsdGeom.BasisCurves.Define(stage, name), clip, is_guide
        self.primvars = UsdGeom.PrimvarsAPI(self.curves)
        self.count = len(clip.guide_index) if is_guide else clip.strand_count

    def describe(self) -> None:
        """Write what is the same in every frame."""
        curves, clip = self.curves, self.clip
        curves.CreateTypeAttr(UsdGeom.Tokens.cubic)
        curves.CreateBasisAttr(UsdGeom.Tokens.catmullRom)
        curves.CreateWrapAttr(UsdGeom.Tokens.pinned)
        of_guides = np.full(self.count, clip.point_count, np.int32)
        curves.CreateCurveVertexCountsAttr(Vt.IntArray.FromNumpy(of_guides if self.is_guide else clip.counts))
        widths = np.tile(clip.strand_width, self.count) if self.is_guide else clip.widths
        curves.CreateWidthsAttr(Vt.FloatArray.FromNumpy(widths))
        curves.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        self._add_display_colour()
        if self.is_guide:
            curves.CreatePurposeAttr(UsdGeom.Tokens.guide)
        bind_material(curves.GetPrim(), f"{ROOT}/Materials/Hair")
        self._add_groom_attributes()
        self._add_held_parts(clip.guide_held_parts if self.is_guide else clip.held_parts)
        rest = clip.rest_guides if self.is_guide else clip.rest_points
        self._add("rest", Sdf.ValueTypeNames.Point3fArray, UsdGeom.Tokens.vertex, _points(rest))

    def _add_display_colour(self) -> None:
        """What renderers show, and the material takes."""
        if self.is_guide or not self.clip.has_colours:
            self.curves.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set([HAIR_COLOUR])
            return
        colours = Vt.Vec3fArray.FromNumpy(self.clip.colours)
        self.curves.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(colours)

    def _add_groom_attributes(self) -> None:
        """Attributes of Unreal's Alembic convention. Ids of strands are those of their source, or continue those of the
        guides, where there are any."""
        clip = self.clip
        self._add_integers("groom_id", self._identifiers())
        self._add_integers("groom_guide", np.full(self.count, self.is_guide))
        groups = clip.guide_groups if self.is_guide else clip.groups
        self._add_integers("groom_group_id", groups)
        if clip.has_groups:
            self._add_group_names(groups)
        of_guides = self.count * clip.point_count
        colour = Vt.Vec3fArray(of_guides, HAIR_COLOUR) if self.is_guide else Vt.Vec3fArray.FromNumpy(clip.colours)
        self._add("groom_color", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex, colour)
        root_uv = clip.guide_root_uv if self.is_guide else clip.root_uv
        if root_uv is not None:
            kind = Sdf.ValueTypeNames.TexCoord2fArray
            self._add("groom_root_uv", kind, UsdGeom.Tokens.uniform, Vt.Vec2fArray.FromNumpy(root_uv))
        if clip.settings.guides and not self.is_guide:
            guides, weights = clip.closest_guides
            self._add(
                "groom_closest_guides",
                Sdf.ValueTypeNames.Int3Array,
                UsdGeom.Tokens.uniform,
                Vt.Vec3iArray.FromNumpy(clip.guide_identifiers[guides]),
            )
            self._add(
                "groom_guide_weights",
                Sdf.ValueTypeNames.Float3Array,
                UsdGeom.Tokens.uniform,
                Vt.Vec3fArray.FromNumpy(weights),
            )

    def _add_group_names(self, groups: np.ndarray) -> None:
        """One name for all where there is one group: Blender says of an array of names that it cannot convert it."""
        names, types, tokens = self.clip.group_names, Sdf.ValueTypeNames, UsdGeom.Tokens
        if len(names) == 1:
            self._add("groom_group_name", types.String, tokens.constant, names[0])
        else:
            self._add("groom_group_name", types.StringArray, tokens.uniform, np.array(names)[groups].tolist())

    def _identifiers(self) -> np.ndarray:
        own, guides = self.clip.identifiers, self.clip.settings.guides
        if self.is_guide:
            return self.clip.guide_identifiers
        return np.arange(self.count) + (len(self.clip.guide_index) if guides else 0) if own is None else own

    def _add_held_parts(self, parts: dict[str, np.ndarray]) -> None:
        for name, values in parts.items():
            if name == TIE_VERTEX:
                self._add_integers(PREFIX + name, values)
            else:
                at_vertices = Vt.FloatArray.FromNumpy(np.ascontiguousarray(values.ravel(), dtype=np.float32))
                self._add(PREFIX + name, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex, at_vertices)

    def _add_integers(self, name: str, values: np.ndarray) -> None:
        array = Vt.IntArray.FromNumpy(values.astype(np.int32))
        self._add(name, Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.uniform, array)

    def _add(self, name: str, kind: Sdf.ValueTypeName, interpolation: str, values: object) -> None:
        self.primvars.CreatePrimvar(name, kind, interpolation).Set(values)


def _new_stage(path: Path) -> Usd.Stage:
    return Usd.Stage.Open(Sdf.Layer.CreateNew(str(path.absolute())))


def _animate_layers(
    stage: Usd.Stage, clip: ExportClip, layers: dict[Path, FrameLayer], on_frame: Callable[[], object]
) -> None:
    """Write points and extents to layers, and name these as value clips.

    Args:
        layers: by the temporary file of each.
    """
    for temporary, each in layers.items():
        part = _new_stage(temporary)
        _set_stage(part, clip, each.frames)
        _animate(part, clip, each.frames, on_frame)
    clips = Usd.ClipsAPI(stage.GetDefaultPrim())
    clips.SetClipPrimPath(ROOT)
    names = [Sdf.AssetPath(f"./{each.path.name}") for each in layers.values()]
    clips.SetClipAssetPaths(Sdf.AssetPathArray(names))
    # It declares what the others hold.
    clips.SetClipManifestAssetPath(names[0])
    active = [(_time_code(clip, each.frames[0]), index) for index, each in enumerate(layers.values())]
    clips.SetClipActive(Vt.Vec2dArray(active))
    _save(stage.GetRootLayer())


def _animate(stage: Usd.Stage, clip: ExportClip, frames: Sequence[int], on_frame: Callable[[], object]) -> None:
    """Write points and extents of frames, one by one."""
    layer, width, unsaved = stage.GetRootLayer(), float(clip.widths.max()), 0.0
    body, strands = stage.OverridePrim(BODY), stage.OverridePrim(STRANDS)
    for frame in frames:
        points = clip.points(frame)
        time = _time_code(clip, frame)
        _set_points(body, clip.body_vertices(frame), time, margin=0.0)
        _set_points(strands, points, time, margin=width)
        if clip.settings.guides:
            _set_points(stage.OverridePrim(GUIDES), clip.guides(frame), time, margin=width)
        unsaved += points.nbytes
        if unsaved > UNSAVED_BYTES and layer.GetFileFormat().formatId != "usda":
            _save(layer)
            unsaved = 0.0
        on_frame()
    _save(layer)


def _save(layer: Sdf.Layer) -> None:
    """Raises:
    OSError: the layer cannot be written.
    """
    if not layer.Save():
        raise OSError("USD could not write it")


def _time_code(clip: ExportClip, frame: int) -> float:
    """Where the frame is among those of the file that the motion comes from."""
    return frame + round(clip.start * clip.sequence.fps, 3)


def _set_points(prim: Usd.Prim, positions: np.ndarray, time: float, margin: float) -> None:
    """A layer of frames does not say what kind of prims these are, so the attributes are made by name."""
    flat = positions.reshape(-1, 3)
    extent = np.stack([flat.min(axis=0) - margin, flat.max(axis=0) + margin])
    tokens, types = UsdGeom.Tokens, Sdf.ValueTypeNames
    for name, kind, values in ((tokens.points, types.Point3fArray, flat), (tokens.extent, types.Float3Array, extent)):
        prim.CreateAttribute(name, kind, custom=False).Set(_points(values), time)


def _points(positions: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(positions.reshape(-1, 3), dtype=np.float32))
