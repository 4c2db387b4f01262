"""What k_Cosserat does to hair: `python scripts/figures/material.py`.

Four hairstyles as designed, then as XPBD settles them under their own weight on the same upright body.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from tiles import FIGURES, at_rest, run_figure

from quaffure.apps.render import write_contact_sheet
from quaffure.body import load_body
from quaffure.config import HairMaterial
from quaffure.procedural import make_groom
from quaffure.solvers import XpbdDraper

OUT = FIGURES / "material.jpg"
STYLES = ("long_straight", "long_wavy", "long_ringlets", "ponytail")
STIFFNESS = (5e-8, 2e-7, 6e-7)  # [J]
WIDTH = 1500


def main() -> list[Path]:
    body = load_body()
    sheet = []
    for style in STYLES:
        scene = at_rest(make_groom(style, body), body)
        sheet.append(scene.groom)
        for k in STIFFNESS:
            settled, report = XpbdDraper(HairMaterial(k_cosserat=k)).solve(scene)
            stretch = settled[0].diff(dim=1).norm(dim=-1) / scene.groom.rest_lengths - 1
            rest = f"gradient {report.relative_gradient:.2g}, stretch {100 * float(stretch.mean()):.2g} %"
            print(f"{style}, {k:g} J: {rest}")
            sheet.append(replace(scene.groom, name=f"{style}, {k:g} J", rest_strands=settled[0]))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.png"
        write_contact_sheet(path, sheet, body)
        picture = Image.open(path).convert("RGB")
    picture.resize((WIDTH, WIDTH * picture.height // picture.width)).save(OUT, quality=80, optimize=True)
    return [OUT]


if __name__ == "__main__":
    run_figure(main)
