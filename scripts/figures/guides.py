"""Hair between draped guides (docs/guides.md): above only the guides, below all strands made of them."""

from pathlib import Path

from tiles import FIGURES, TileRenderer, View, at_rest, grid, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.benchmark import load_evaluation_set
from quaffure.body import BodyModel
from quaffure.hair import Groom
from quaffure.io.load_groom import load_groom
from quaffure.model import load_model

OUT = FIGURES / "guides.jpg"
GROOM_FOLDER = Path("data/grooms")
BUNDLED = ("long_wavy", "short_curly")
VIEWS = (View(40.0, 0.42, 0.02), View(180.0, 0.56, 0.12), View(40.0, 0.44, -0.01))
SIZE = 400  # pixels


def main(groom_folder: Path = GROOM_FOLDER) -> list[Path]:
    model = load_model()
    above, below = [], []
    with TileRenderer(SIZE, SIZE, strands=20_000) as renderer:
        grooms = (_sintel(groom_folder, model.body), *(load_groom(name, model.body) for name in BUNDLED))
        for groom, view in zip(grooms, VIEWS):
            print(f"{groom.name}: {len(groom)} guides")
            scene = at_rest(groom, model.body)
            guides = model.draper.drape(scene)
            above.append(renderer.strands_alone(guides[0], scene.bodies, 0, view, NATURAL_COLOURS[1]))
            below += renderer.tiles(scene, guides, view, NATURAL_COLOURS[1])
    save_picture(OUT, grid([above, below]))
    return [OUT]


def _sintel(folder: Path, body: BodyModel) -> Groom:
    source = load_evaluation_set().grooms["sintel"]
    return load_groom(folder / source.file, body, folder / source.head)


if __name__ == "__main__":
    run_figure(main)
