"""Fig. 11: one hairstyle with k_Cosserat from stiff to soft, settled by Adam on directions.

The network has one material, the package's default, so a solver stands in for it.
"""

from pathlib import Path

from tiles import FIGURES, Caption, TileRenderer, View, at_rest, grid, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.body import load_body
from quaffure.config import HairMaterial
from quaffure.procedural import make_groom
from quaffure.solvers import AdamDraper

OUT = FIGURES / "stiffness.jpg"
GROOM = "long_ringlets"
STIFFNESS = (2e-6, 6e-7, 2e-7, 6e-8, 2e-8)  # [J]
VIEWS = (View(40.0, below_head=0.12), View(180.0, below_head=0.12))


def main() -> list[Path]:
    body = load_body()
    scene = at_rest(make_groom(GROOM, body), body)
    columns = {"as designed": scene.posed}
    for k in STIFFNESS:
        columns[f"k_Cosserat = {k:g} J"] = AdamDraper(HairMaterial(k_cosserat=k)).drape(scene)
    tiles = []
    with TileRenderer(240, 270) as renderer:
        for title, hair in columns.items():
            lower = 100 * float((scene.posed - hair)[:, :, -1, 2].mean())
            caption = Caption(title, (f"tips {lower:.1f} cm lower",))
            tiles.append(renderer.column(scene, hair, VIEWS, NATURAL_COLOURS[2], caption))
    save_picture(OUT, grid([tiles]))
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
