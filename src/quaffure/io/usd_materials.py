"""Simple materials of a drape's stage, for any renderer: `UsdPreviewSurface`."""

from pxr import Sdf, Usd, UsdShade

from quaffure.hair.export_clip import BODY_COLOUR, HAIR_COLOUR


def add_materials(stage: Usd.Stage, scope: str, coloured_hair: bool) -> None:
    """Define `Hair` and `Body` below a scope.

    Args:
        coloured_hair: hair has the colours of its `displayColor`.
    """
    stage.DefinePrim(scope, "Scope")
    for name, colour, roughness in (("Hair", HAIR_COLOUR, 0.35), ("Body", BODY_COLOUR, 0.6)):
        material = UsdShade.Material.Define(stage, f"{scope}/{name}")
        shader = UsdShade.Shader.Define(stage, f"{scope}/{name}/Surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        diffuse.Set(colour)
        if coloured_hair and name == "Hair":
            diffuse.ConnectToSource(_display_colour(stage, f"{scope}/{name}/Colour", colour))
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(roughness)
        surface = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
        material.CreateSurfaceOutput().ConnectToSource(surface)


def _display_colour(stage: Usd.Stage, path: str, otherwise: tuple[float, float, float]) -> UsdShade.Output:
    reader = UsdShade.Shader.Define(stage, path)
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(otherwise)
    return reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)


def bind_material(prim: Usd.Prim, material: str) -> None:
    """Bind a material of the stage by its path."""
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(UsdShade.Material.Get(prim.GetStage(), material))
