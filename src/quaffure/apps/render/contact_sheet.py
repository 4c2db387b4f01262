"""One picture of many hairstyles: each from three sides, at one scale, with its name."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from quaffure.apps.render.camera import Camera
from quaffure.apps.render.pictures import save_png
from quaffure.apps.render.scene import StrandRenderer
from quaffure.body.body_model import BodyModel
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import SHOWN_STRANDS, interpolation_of
from quaffure.io.output_path import check_output

VIEWS = ("3/4", "side", "back")
COLUMNS = 4
TILE_WIDTH, TILE_HEIGHT = 194, 262  # pixels
GAP, CAPTION, CAPTION_SIZE = 18, 40, 20  # pixels
SUPERSAMPLING = 3
# Width of a tile in the scene, height of its upper edge above the Head joint, and its margin above higher hair [m].
TILE_EXTENT, TILE_TOP, TOP_MARGIN = 0.36, 0.19, 0.015
PAPER, INK, PALE_INK = (246, 246, 247), (38, 38, 42), (128, 128, 136)
NATURAL_COLOURS = (
    (0.150, 0.062, 0.025),  # chestnut
    (0.520, 0.340, 0.165),  # blonde
    (0.140, 0.034, 0.015),  # auburn
    (0.340, 0.190, 0.080),  # dark blonde
    (0.012, 0.010, 0.009),  # black
    (0.030, 0.016, 0.010),  # dark brown
    (0.065, 0.030, 0.015),  # brown
    (0.020, 0.012, 0.009),  # brown black
    (0.300, 0.095, 0.030),  # copper
)
"""Albedos of hair, in linear RGB."""


def write_contact_sheet(
    path: Path,
    grooms: Sequence[Groom],
    body: BodyModel,
    notes: dict[str, str] | None = None,
    on_groom: Callable[[int], None] | None = None,
) -> None:
    """Write one picture (.png) of grooms at rest, in rows of four; each front three-quarter, side and back.

    Args:
        body: body that the grooms are registered to, drawn at rest.
        notes: text after a groom's name, by name.
        on_groom: called with the number of grooms drawn so far.

    Raises:
        InputError: not a .png, not writable, or no OpenGL on this machine.
    """
    check_output(path, ".png")
    rows = -(-len(grooms) // COLUMNS)
    cell_width, cell_height = len(VIEWS) * TILE_WIDTH, TILE_HEIGHT + CAPTION
    size = (COLUMNS * (cell_width + GAP) + GAP, rows * (cell_height + GAP) + GAP)
    sheet = Image.new("RGB", size, PAPER)
    pen = ImageDraw.Draw(sheet)
    with StrandRenderer(TILE_WIDTH, TILE_HEIGHT, supersampling=SUPERSAMPLING) as renderer:
        for index, groom in enumerate(grooms):
            left = GAP + (index % COLUMNS) * (cell_width + GAP)
            top = GAP + (index // COLUMNS) * (cell_height + GAP)
            colour = NATURAL_COLOURS[index % len(NATURAL_COLOURS)]
            sheet.paste(Image.fromarray(_views(groom, body, renderer, colour)), (left, top))
            _write_caption(pen, groom.name, (notes or {}).get(groom.name, ""), (left, top + TILE_HEIGHT))
            if on_groom is not None:
                on_groom(index + 1)
    save_png(path, sheet)


def _views(
    groom: Groom, body: BodyModel, renderer: StrandRenderer, hair_colour: tuple[float, float, float]
) -> UInt8[np.ndarray, "h w 3"]:
    vertices, faces = body.rest_vertices.numpy(), body.faces.numpy()
    strands = interpolation_of(groom, body, SHOWN_STRANDS).strands(groom.rest_strands.numpy(), vertices)
    head = body.rest_joints[body.joint_names.index("Head")].numpy()
    top = max(head[2] + TILE_TOP, float(groom.rest_strands[..., 2].max()) + TOP_MARGIN)
    centre = np.array([head[0], head[1], top - 0.5 * TILE_EXTENT * TILE_HEIGHT / TILE_WIDTH])
    return np.hstack(
        [
            renderer.render(strands, vertices, faces, Camera.view(view, centre, TILE_EXTENT), hair_colour)
            for view in VIEWS
        ]
    )


def _write_caption(pen: ImageDraw.ImageDraw, name: str, note: str, corner: tuple[int, int]) -> None:
    text = name.replace("_", " ")
    font, small = ImageFont.load_default(CAPTION_SIZE), ImageFont.load_default(0.75 * CAPTION_SIZE)
    left, base = corner[0] + 4, corner[1] + CAPTION - 12
    pen.text((left, base), text, fill=INK, font=font, anchor="ls")
    pen.text((left + pen.textlength(text, font) + 12, base), note, fill=PALE_INK, font=small, anchor="ls")
