"""The pictures of docs/concepts.md: `python scripts/figures/concepts.py`.

One picture a concept. `--only groom` draws one of them.
"""

from collections.abc import Callable
from pathlib import Path

import torch
from tiles import FIGURES, Caption, Picture, TileRenderer, View, at_rest, captioned, grid, run_figure, save_picture

from quaffure.apps.render import NATURAL_COLOURS
from quaffure.body import BodyModel, bundled_clip, load_body
from quaffure.energies import HairEnergy, hair_terms, released
from quaffure.hair import Groom
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper
from quaffure.solvers.strand_newton import StrandNewtonSetting
from quaffure.types import Positions

WIDTH, HEIGHT, STRANDS = 210, 236, 10_000
MOST_BYTES = 120_000
GUIDES = 150
BOW_FRAME, TURN_FRAME = 60, 36
TERMS = {"elastic": "bending", "gravity": "gravity", "body_collision": "body", "self_collision": "hair on hair"}


def main(only: str = "") -> list[Path]:
    body, written = load_body(), []
    pictures: dict[str, Callable[[TileRenderer, BodyModel], Picture]] = {
        "groom": groom, "body": bodies, "drape": drape, "energy": energy, "rest": rest, "ties": ties,
    }  # fmt: skip
    with TileRenderer(WIDTH, HEIGHT, STRANDS) as renderer:
        for name, picture in pictures.items():
            if only in ("", name):
                written.append(FIGURES / f"concept_{name}.jpg")
                save_picture(written[-1], picture(renderer, body), MOST_BYTES)
    return written


def groom(renderer: TileRenderer, body: BodyModel) -> Picture:
    """The bare scalp, a few guides, all of them, and the strands in between."""
    scene, view, colour = (
        at_rest(make_groom("wavy_bob", body), body),
        View(30.0, extent=0.45, below_head=0.03),
        NATURAL_COLOURS[0],
    )
    guides, few = scene.posed[0], scene.groom.thinned(GUIDES).rest_strands
    tiles = {
        "the scalp": renderer.strands_alone(guides[:0], scene.bodies, 0, view, colour),
        f"{len(few)} of its guides": renderer.strands_alone(few, scene.bodies, 0, view, colour),
        f"all {len(guides)} guides": renderer.strands_alone(guides, scene.bodies, 0, view, colour),
        f"{STRANDS} strands between them": renderer.tiles(scene, scene.posed, view, colour)[0],
    }
    return grid([[captioned(tile, Caption(title)) for title, tile in tiles.items()]])


def bodies(renderer: TileRenderer, body: BodyModel) -> Picture:
    """Bodies of several shapes in the rest pose, and the mean one in a bow."""
    view, shape = View(25.0, extent=1.1, below_head=0.3), torch.zeros(4, 10)
    shape[1, 0], shape[2, 1] = -2.5, 2.5
    pose = torch.cat([torch.zeros(3, 81), bundled_clip("bow", body).body_pose[BOW_FRAME : BOW_FRAME + 1]])
    batch, titles = (
        BodyBatch(body, pose, shape),
        ("mean shape", "shape: first -2.5", "shape: second 2.5", "pose: a bow"),
    )
    bare = torch.zeros(0, 2, 3)
    tiles = [renderer.strands_alone(bare, batch, sample, view, NATURAL_COLOURS[0]) for sample in range(4)]
    return grid([[captioned(tile, Caption(title)) for tile, title in zip(tiles, titles)]])


def drape(renderer: TileRenderer, body: BodyModel) -> Picture:
    """Design, the same hair moved rigidly with the scalp, and its drape."""
    hair, view = make_groom("long_straight", body), View(35.0, extent=0.8, below_head=0.18)
    upright, bowed = at_rest(hair, body), _in_clip(hair, body, "bow", BOW_FRAME)
    shown = [(upright, upright.posed, "groom"), (bowed, bowed.posed, "posed"), (bowed, _draped(bowed), "draped")]
    return _row(renderer, shown, view, NATURAL_COLOURS[1])


def energy(renderer: TileRenderer, body: BodyModel) -> Picture:
    """The terms of the energy while the solver lowers it."""
    hair, view = make_groom("long_wavy", body), View(15.0, extent=0.62, below_head=0.12)
    scene = _in_clip(hair, body, "neck_turn", TURN_FRAME)
    of_groom = StrandNewtonDraper().energy_of(scene)
    tiles = []
    for title, positions in {"posed": scene.posed, "5 passes": _draped(scene, 5), "20 passes": _draped(scene)}.items():
        caption = Caption(title, tuple(_terms(of_groom, positions, scene)))
        print(caption)
        tiles.append(renderer.column(scene, positions, [view], NATURAL_COLOURS[2], caption))
    return grid([tiles])


def rest(renderer: TileRenderer, body: BodyModel) -> Picture:
    """An upright groom: as designed, draped with the design as its stress-free shape, draped with the sag-free one."""
    hair, view = make_groom("long_coils", body), View(35.0, extent=0.66, below_head=0.14)
    scene = at_rest(hair, body)
    stress_free, sag_free = StrandNewtonDraper(terms=hair_terms("rod")).drape(scene), _draped(scene)
    shown = []
    for title, positions in (("as designed", scene.posed), ("stress-free", stress_free), ("sag-free", sag_free)):
        moved = 1000 * float((positions - scene.posed).norm(dim=-1).mean())
        print(title, moved)
        shown.append((scene, positions, f"{title}: {moved:.1f} mm away" if moved else title))
    return _row(renderer, shown, view, NATURAL_COLOURS[3])


def ties(renderer: TileRenderer, body: BodyModel) -> Picture:
    """Pigtails as designed, in a turn of the neck, and there without their ties."""
    hair, view = make_groom("pigtails", body), View(20.0, extent=0.75, below_head=0.15)
    upright, turned = at_rest(hair, body), _in_clip(hair, body, "neck_turn", TURN_FRAME)
    loose = _in_clip(released(hair, torch.ones(len(hair), dtype=torch.bool)), body, "neck_turn", TURN_FRAME)
    shown = [
        (upright, upright.posed, "as designed"), (turned, _draped(turned), "with ties"),
        (loose, _draped(loose), "without ties"),
    ]  # fmt: skip
    return _row(renderer, shown, view, NATURAL_COLOURS[0])


def _in_clip(hair: Groom, body: BodyModel, clip: str, frame: int) -> Scene:
    pose = bundled_clip(clip, body).body_pose[frame : frame + 1]
    return Scene(hair, BodyBatch(body, pose, torch.zeros(1, 10)))


def _draped(scene: Scene, passes: int | None = None) -> Positions:
    setting = None if passes is None else StrandNewtonSetting(passes=passes)
    return StrandNewtonDraper(setting=setting).drape(scene)


def _terms(energy: HairEnergy, positions: Positions, scene: Scene) -> list[str]:
    """Lines of the terms in m g L a vertex."""
    found = energy.by_term(positions, scene)
    return [f"{name}: {float(energy.per_vertex(found[key])):.3g}" for key, name in TERMS.items() if key in found]


def _row(
    renderer: TileRenderer,
    shown: list[tuple[Scene, Positions, str]],
    view: View,
    colour: tuple[float, float, float],
) -> Picture:
    return grid([[renderer.column(scene, hair, [view], colour, Caption(title)) for scene, hair, title in shown]])


if __name__ == "__main__":
    run_figure(main)
