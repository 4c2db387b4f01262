"""Operators and their panel: add a character with a groom, drape a frame, bake a range."""

import shutil
import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from . import character
from .process import QuaffureError, Run, run

SECONDS = 0.2
"""Between looks at a bake that runs."""


def python_of(context: bpy.types.Context) -> str:
    return context.preferences.addons[__package__].preferences.python


def reported(execute: Callable) -> Callable:
    """Errors of quaffure and of the scene as one line of the operator's report."""

    def wrapped(self: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
        try:
            return execute(self, context)
        except (QuaffureError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    return wrapped


def drape_arguments(context: bpy.types.Context, folder: Path, frames: range) -> list[str]:
    """Of `quaffure`, to drape the chosen hair on the armature in these frames; writes the motion for it."""
    settings = context.scene.quaffure
    if settings.hair is None or settings.armature is None:
        raise ValueError("expected hair of Add Character and an armature, found none chosen")
    motion = folder / "motion.npz"
    np.savez(motion, **character.motion_of(settings.armature, frames))
    # Hair is draped in the armature's axes.
    turned = settings.armature.matrix_world.to_3x3().normalized().inverted()
    gravity, wind = (
        ",".join(f"{value:.6g}" for value in turned @ Vector(vector)) for vector in (settings.gravity, settings.wind)
    )
    shape = ",".join(f"{value:.6g}" for value in settings.hair[character.SHAPE])
    arguments = ["drape", settings.hair[character.GROOM], "--motion", str(motion), f"--shape={shape}"]
    arguments += [f"--gravity={gravity}", f"--wind={wind}", "--draper", settings.draper]
    return arguments if settings.stiffness == 1 else [*arguments, "--stiffness", f"{settings.stiffness:.6g}"]


class AddCharacter(bpy.types.Operator):
    """Add the body with its armature and a groom on it"""

    bl_idname = "quaffure.add_character"
    bl_label = "Add Character"
    bl_options = {"REGISTER", "UNDO"}

    @reported
    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.quaffure
        with tempfile.TemporaryDirectory() as folder:
            rig = Path(folder) / "rig.npz"
            groom = bpy.path.abspath(settings.groom) if settings.groom.startswith("//") else settings.groom
            run(python_of(context), ["rig", groom, "--out", rig])
            _, settings.armature, settings.hair = character.add_character(rig, groom)
        return {"FINISHED"}


class DrapeFrame(bpy.types.Operator):
    """Drape the hair in this frame"""

    bl_idname = "quaffure.drape_frame"
    bl_label = "Drape Frame"
    bl_options = {"REGISTER", "UNDO"}

    @reported
    def execute(self, context: bpy.types.Context) -> set[str]:
        frame = context.scene.frame_current
        with tempfile.TemporaryDirectory() as folder:
            drape = Path(folder) / "drape.npz"
            arguments = drape_arguments(context, Path(folder), range(frame, frame + 1))
            run(python_of(context), [*arguments, "--out", drape])
            with np.load(drape, allow_pickle=False) as arrays:
                strands = arrays["strands"][0]
        curves = context.scene.quaffure.hair.data
        if len(curves.points) != strands.size // 3:
            raise ValueError(f"expected hair of {strands.size // 3} points, found {len(curves.points)}")
        character.set_strands(curves, strands)
        return {"FINISHED"}


class Bake(bpy.types.Operator):
    """Drape the hair in all frames of the scene's range, into a file that plays without the add-on; Esc cancels"""

    bl_idname = "quaffure.bake"
    bl_label = "Bake"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        try:
            self._start(context)
        except (QuaffureError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(SECONDS, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC":
            self._run.cancel()
            # The frames of a longer run, which quaffure keeps for --resume.
            shutil.rmtree(self._cache.with_name(f".{self._cache.name}.frames"), ignore_errors=True)
            self._stop(context)
            self.report({"INFO"}, "bake cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        for done, total in self._run.progress():
            context.window_manager.progress_update(100 * done / total)
            context.workspace.status_text_set(f"Draping frame {done} of {total} (Esc cancels)")
        if self._run.is_running:
            return {"RUNNING_MODAL"}
        self._stop(context)
        return self._finish(context)

    @reported
    def execute(self, context: bpy.types.Context) -> set[str]:
        self._start(context)
        return self._finish(context)

    def _start(self, context: bpy.types.Context) -> None:
        scene, settings = context.scene, context.scene.quaffure
        folder = Path(bpy.path.abspath(settings.folder) if bpy.data.filepath else tempfile.mkdtemp(prefix="quaffure-"))
        folder.mkdir(parents=True, exist_ok=True)
        self._range = range(scene.frame_start, scene.frame_end + 1)
        arguments = drape_arguments(context, folder, self._range)
        # A new name each time: Blender keeps what it has read of a file.
        name = bpy.path.clean_name(settings.hair.name)
        names = (folder / f"{name}_{number:03}.usdc" for number in count(1))
        self._cache = next(path for path in names if not path.exists())
        more = ["--strands", str(settings.strands)] if settings.strands else []
        self._run = Run(python_of(context), [*arguments, *more, "--out", str(self._cache)])

    def _stop(self, context: bpy.types.Context) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    @reported
    def _finish(self, context: bpy.types.Context) -> set[str]:
        self._run.finish()
        hair = context.scene.quaffure.hair
        baked = _imported_strands(self._cache)
        baked.name = f"{hair.name} baked"
        baked.parent, baked.matrix_parent_inverse = context.scene.quaffure.armature, hair.matrix_parent_inverse
        baked.data.materials.clear()
        for own in hair.data.materials:
            baked.data.materials.append(own)
        for modifier in baked.modifiers:
            if modifier.type == "MESH_SEQUENCE_CACHE":
                modifier.cache_file.frame_offset = self._range.start
        hair.hide_set(True)
        hair.hide_render = True
        return {"FINISHED"}


def _imported_strands(path: Path) -> bpy.types.Object:
    """The strands of a USD file, without its body."""
    scene = bpy.context.scene
    times = scene.frame_start, scene.frame_end, scene.frame_current, scene.render.fps, scene.render.fps_base
    before = {*bpy.data.objects}
    bpy.ops.wm.usd_import(filepath=str(path), set_frame_range=False)
    scene.frame_start, scene.frame_end, scene.frame_current, scene.render.fps, scene.render.fps_base = times
    added = [thing for thing in bpy.data.objects if thing not in before]
    (strands,) = (thing for thing in added if thing.type == "CURVES")
    strands.parent = None
    for thing in added:
        if thing is not strands:
            bpy.data.objects.remove(thing)
    return strands


class Panel(bpy.types.Panel):
    bl_idname = "VIEW3D_PT_quaffure"
    bl_label = "Quaffure Hair"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Quaffure"

    def draw(self, context: bpy.types.Context) -> None:
        settings, column = context.scene.quaffure, self.layout.column()
        column.prop(settings, "groom")
        column.operator(AddCharacter.bl_idname)
        for name in ("hair", "armature", "draper", "stiffness", "gravity", "wind"):
            column.prop(settings, name)
        column.operator(DrapeFrame.bl_idname)
        for name in ("strands", "folder"):
            column.prop(settings, name)
        column.operator(Bake.bl_idname)


CLASSES = (AddCharacter, DrapeFrame, Bake, Panel)
