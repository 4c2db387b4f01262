"""The strip in docs/groom_code.md: `python scripts/figures/groom_code.py RUN`, a folder of `quaffure train-code`.

In every row a groom, what its code decodes to, three steps to the code of another groom, and that groom itself.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image, ImageDraw, ImageFont
from tiles import FIGURES, run_figure

from quaffure.apps.render import Camera, StrandRenderer
from quaffure.body import BodyModel, load_body
from quaffure.geometry import Surface
from quaffure.hair import Groom, interpolation_of, pushed_out
from quaffure.model import GroomAutoencoder, load_groom_autoencoder, strands_from_features
from quaffure.model.groom_code import groom_code
from quaffure.procedural import make_groom

OUT = FIGURES / "groom_code.jpg"
# The last pair are two styles that no training used.
PAIRS = (("bob", "long_wavy"), ("short_curly", "long_straight"), ("mohawk", "afro"), ("side_part_lob", "mullet"))
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
TILE_WIDTH, TILE_HEIGHT, EXTENT, TOP = 190, 250, 0.42, 0.22
CAPTION, STRANDS = 26, 12_000


def main(run: tyro.conf.Positional[Path]) -> list[Path]:
    body = load_body()
    surface = body.rest_surface
    network = load_groom_autoencoder(run / "groom_autoencoder.safetensors")
    titles = ["a groom", *(f"{share:g}" for share in SHARES), "another groom"]
    with StrandRenderer(TILE_WIDTH, TILE_HEIGHT) as renderer:
        rows = [_captions(titles)]
        for names in PAIRS:
            first, second = (make_groom(name, body) for name in names)
            rows.append(np.hstack([_tile(g, body, renderer) for g in _between(network, first, second, body, surface)]))
            rows.append(_captions([names[0].replace("_", " "), *[""] * len(SHARES), names[1].replace("_", " ")]))
    Image.fromarray(np.vstack(rows)).save(OUT, quality=82, optimize=True)
    return [OUT]


def _between(network: GroomAutoencoder, first: Groom, second: Groom, body: BodyModel, surface: Surface) -> list[Groom]:
    """Both grooms, and between them what their codes and mixtures of these decode to, on the first one's roots."""
    codes = [groom_code(groom, body, network.encoder) for groom in (first, second)]
    texels = first.texels()
    mixed = []
    for share in SHARES:
        with torch.no_grad():
            code = torch.lerp(codes[0], codes[1], share)[None]
            features = network.decoder(code, torch.zeros_like(texels), texels)
        # The decoder has no body as input: what it leaves inside is moved out, as for the grooms themselves.
        mixed.append(replace(first, rest_strands=pushed_out(strands_from_features(features, first, body), surface)))
    return [first, *mixed, second]


def _tile(groom: Groom, body: BodyModel, renderer: StrandRenderer) -> np.ndarray:
    vertices, head = body.rest_vertices.numpy(), body.rest_joints[body.joint_names.index("Head")].numpy()
    strands = interpolation_of(groom, body, STRANDS).strands(groom.rest_strands.numpy(), vertices)
    centre = np.array([head[0], head[1], head[2] + TOP - 0.5 * EXTENT * TILE_HEIGHT / TILE_WIDTH])
    return renderer.render(strands, vertices, body.faces.numpy(), Camera.view("3/4", centre, EXTENT))


def _captions(texts: list[str]) -> np.ndarray:
    strip = Image.new("RGB", (len(texts) * TILE_WIDTH, CAPTION), (246, 246, 247))
    pen, font = ImageDraw.Draw(strip), ImageFont.load_default(15)
    for column, text in enumerate(texts):
        pen.text(((column + 0.5) * TILE_WIDTH, CAPTION / 2), text, fill=(38, 38, 42), font=font, anchor="mm")
    return np.asarray(strip)


if __name__ == "__main__":
    run_figure(main)
