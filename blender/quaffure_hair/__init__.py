"""Hair of a character, draped by quaffure: a body with a groom, its drape in this frame, and a bake of a range.

The add-on runs `python -m quaffure` with the Python that its preferences name, and exchanges `.npz` and USD files with
it, so that Blender's own Python needs nothing.
"""

import bpy

from . import operators, settings

CLASSES = (settings.Preferences, settings.Settings, *operators.CLASSES)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.quaffure = bpy.props.PointerProperty(type=settings.Settings)


def unregister() -> None:
    del bpy.types.Scene.quaffure
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
