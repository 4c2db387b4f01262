"""Preferences of the add-on, and what a scene's drapes are made with."""

import bpy


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    python: bpy.props.StringProperty(
        name="Python",
        description="A Python in which quaffure is installed: pip install 'quaffure[usd]'",
        subtype="FILE_PATH",
        default="python3",
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "python")


class Settings(bpy.types.PropertyGroup):
    groom: bpy.props.StringProperty(
        name="Groom", description="A bundled style (quaffure grooms), or a groom file", default="bob"
    )
    hair: bpy.props.PointerProperty(
        name="Hair", type=bpy.types.Object, poll=lambda _, thing: thing.type == "CURVES" and "quaffure_groom" in thing
    )
    armature: bpy.props.PointerProperty(
        name="Armature", type=bpy.types.Object, poll=lambda _, thing: thing.type == "ARMATURE"
    )
    stiffness: bpy.props.FloatProperty(
        name="Stiffness",
        description="Multiple of a hair's: 0.3 is fine, 3 is coarse hair",
        default=1,
        min=0.01,
        max=100,
    )
    gravity: bpy.props.FloatVectorProperty(
        name="Gravity", subtype="ACCELERATION", default=(0, 0, -9.81), min=-100, max=100
    )
    wind: bpy.props.FloatVectorProperty(
        name="Wind", description="Acceleration that pulls all hair alike", subtype="ACCELERATION", min=-100, max=100
    )
    strands: bpy.props.IntProperty(
        name="Strands",
        description="Strands between the guides in a bake; 0: the guides alone",
        default=0,
        min=0,
        max=200_000,
    )
    draper: bpy.props.EnumProperty(
        name="Method",
        items=(
            ("strand_newton", "Solver", "Frames follow each other; seconds a frame"),
            ("neural", "Network", "Every frame alone; milliseconds a frame"),
            ("posed", "Posed", "The groom carried rigidly by the scalp"),
        ),
    )
    folder: bpy.props.StringProperty(
        name="Cache", description="Where bakes are written", subtype="DIR_PATH", default="//quaffure"
    )
