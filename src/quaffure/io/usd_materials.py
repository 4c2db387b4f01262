"""Simple materials of a drape's stage, for any renderer: `UsdPreviewSurface`."""

from pxr import Sdf, Usd, UsdShade

from quaffure.hair.export_clip import BODY_COLOUR, HAIR_COLOUR


def add_materials(stage: Usd.Stage, scope: str) -> None:
    """Define `Hair` and `Body` below a scope."""
    stage.DefinePrim(scope, "Scope")
    for name, colour, roughness in (("Hair", HAIR_COLOUR, 0.35), ("Body", BODY_COLOUR, 0.6)):
        material = UsdShade.Material.Define(stage, f"{scope}/{name}")
        shader = UsdShade.Shader.Define(stage, f"{scope}/{name}/Surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(colour)
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(roughness)
        surface = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
        material.CreateSurfaceOutput().ConnectToSource(surface)


def bind_material(prim: Usd.Prim, material: str) -> None:
    """Bind a material of the stage by its path."""
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(UsdShade.Material.Get(prim.GetStage(), material))
