"""Shared by the scripts of this folder: scenes, tiles of drapes, captions, a compressed picture, the command line."""

import io
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np
import torch
import tyro
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from quaffure.apps.render import Camera, StrandRenderer
from quaffure.apps.render.contact_sheet import INK, PALE_INK, PAPER
from quaffure.benchmark import CaseEntry, DataFolders, GroomSource, load_cases, load_evaluation_set
from quaffure.body import BodyModel
from quaffure.errors import InputError
from quaffure.hair import Groom, GuideInterpolation, interpolation_of
from quaffure.io import replacing
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Float, Positions, Tensor

FIGURES = Path(__file__).parents[2] / "docs" / "figures"
MOTION_FOLDER = Path("data/motion")
MOST_BYTES = 250_000
BEST_QUALITY, LEAST_QUALITY = 90, 40
FONT_SIZE, LINE, GAP = 13, 18, 6  # pixels

Picture = UInt8[np.ndarray, "h w 3"]
Colour = tuple[float, float, float]


class View(NamedTuple):
    """The camera of a tile, relative to the front of the chest, so that a turn of the head is visible.

    Attributes:
        azimuth_deg: as of `Camera.around`.
        extent: what the tile's shorter side shows [m].
        below_head: how far under the Head joint the middle of the tile lies [m].
    """

    azimuth_deg: float = 15.0
    extent: float = 0.62
    below_head: float = 0.10
    rise_deg: float = 4.0

    def camera(self, bodies: BodyBatch, sample: int) -> Camera:
        names, posed = bodies.body.joint_names, bodies.posed
        x, y, z = posed.joint_positions[sample, names.index("Head")].tolist()
        chest = posed.joint_rotations[sample, names.index("Spine1")]
        facing = float(torch.rad2deg(torch.atan2(-chest[0, 1], chest[1, 1])))
        centre = np.array([x, y, z - self.below_head])
        return Camera.around(centre, self.extent, facing + self.azimuth_deg, self.rise_deg)


@dataclass(frozen=True)
class Caption:
    """What stands under a tile: a title, and fainter lines below it."""

    title: str
    notes: tuple[str, ...] = ()


class TileRenderer:
    """Draws drapes as tiles of one size, with the hair between their guides.

    Args:
        width, height: of a tile [pixels].
        strands: drawn of every groom.
    """

    def __init__(self, width: int, height: int, strands: int = 12_000, supersampling: int = 3) -> None:
        self.strands = strands
        self._renderer = StrandRenderer(width, height, supersampling=supersampling)
        self._between: dict[int, tuple[Groom, GuideInterpolation]] = {}

    def __enter__(self) -> "TileRenderer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._renderer.release()

    def tiles(self, scene: Scene, draped: Positions, view: View, colour: Colour) -> list[Picture]:
        """A tile of every sample of a scene.

        Args:
            draped: vertices of the guides [m, world].
            colour: of the hair, albedo in linear RGB.
        """
        bodies, between = scene.bodies, self._interpolation(scene)
        faces, vertices = bodies.body.faces.numpy(), bodies.posed.vertices.numpy()
        return [
            self._renderer.render(between.strands(guides, skin), skin, faces, view.camera(bodies, sample), colour)
            for sample, (guides, skin) in enumerate(zip(draped.numpy(), vertices))
        ]

    def strands_alone(
        self, strands: Float[Tensor, "s n 3"], bodies: BodyBatch, sample: int, view: View, colour: Colour
    ) -> Picture:
        """A tile of just these strands [m, world] on one of the bodies; of the bare body where there are none."""
        faces, skin = bodies.body.faces.numpy(), bodies.posed.vertices[sample].numpy()
        unseen = np.broadcast_to(
            skin.mean(axis=0), (1, 2, 3)
        )  # the renderer asks for a strand; this one is in the chest
        drawn = strands.numpy() if len(strands) else unseen
        return self._renderer.render(drawn, skin, faces, view.camera(bodies, sample), colour)

    def column(
        self, scene: Scene, draped: Positions, views: Sequence[View], colour: Colour, caption: Caption
    ) -> Picture:
        """Tiles of all views and samples one below another, with a caption."""
        tiles = [tile for view in views for tile in self.tiles(scene, draped, view, colour)]
        return captioned(np.vstack(tiles), caption)

    def _interpolation(self, scene: Scene) -> GuideInterpolation:
        groom = scene.groom
        if id(groom) not in self._between:  # the groom is kept as well: an id is good as long as its object lives
            self._between[id(groom)] = groom, interpolation_of(groom, scene.bodies.body, self.strands)
        return self._between[id(groom)][1]


def captioned(tile: Picture, caption: Caption) -> Picture:
    """The tile with its caption below; a caption of more lines is higher.

    Raises:
        InputError: a line that is wider than the tile.
    """
    width, lines = tile.shape[1], (caption.title, *caption.notes)
    strip = Image.new("RGB", (width, LINE * len(lines) + GAP), PAPER)
    pen, font = ImageDraw.Draw(strip), ImageFont.load_default(FONT_SIZE)
    for row, line in enumerate(lines):
        needed = pen.textlength(line, font)
        if needed > width:
            raise InputError(f"caption '{line}'", f"at most {width} pixels", f"{needed:.0f}")
        pen.text((2, GAP // 2 + LINE * row), line, INK if row == 0 else PALE_INK, font)
    return np.vstack([tile, np.asarray(strip)])


def grid(rows: Sequence[Sequence[Picture]]) -> Picture:
    """Tiles of one size in rows and columns, paper between and around them; rows may be shorter than the longest.

    Raises:
        InputError: tiles of several sizes.
    """
    sizes = {tile.shape for row in rows for tile in row}
    if len(sizes) != 1:
        raise InputError("tiles", "one size (captions with equally many lines)", f"{sorted(sizes)}")
    height, width, _ = sizes.pop()
    columns = max(map(len, rows))
    sheet = np.empty((GAP + len(rows) * (height + GAP), GAP + columns * (width + GAP), 3), np.uint8)
    sheet[:] = PAPER
    for i, row in enumerate(rows):
        for j, tile in enumerate(row):
            top, left = GAP + i * (height + GAP), GAP + j * (width + GAP)
            sheet[top : top + height, left : left + width] = tile
    return sheet


def save_picture(path: Path, picture: Picture, most_bytes: int = MOST_BYTES) -> None:
    """Write a .jpg in the best quality that keeps it light.

    Raises:
        InputError: the folder is missing, or no quality is light enough.
    """
    for quality in range(BEST_QUALITY, LEAST_QUALITY - 1, -5):
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "JPEG", quality=quality, optimize=True)
        if buffer.tell() <= most_bytes:
            with replacing(path) as temporary:
                temporary.write_bytes(buffer.getvalue())
            return
    raise InputError(path, f"a picture of at most {most_bytes} bytes", f"{buffer.tell()} at quality {LEAST_QUALITY}")


def at_rest(groom: Groom, body: BodyModel) -> Scene:
    """The groom on the mean body in its rest pose."""
    return Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))


def load_scenes(entries: Sequence[CaseEntry], motion_folder: Path, body: BodyModel) -> Iterator[Scene]:
    """Bundled grooms on clips and bodies of the evaluation set, none of which any training used.

    Raises:
        InputError: a clip that is not in `motion_folder`.
    """
    of = load_evaluation_set()
    of = replace(of, grooms={entry.groom: GroomSource("") for entry in entries})
    for case in load_cases(entries, of, DataFolders((motion_folder,), ()), body):
        yield Scene(case.groom, case.bodies(body))


def run_figure(main: Callable[..., list[Path]]) -> None:
    """Run the `main` of a script with the options of the command line, and say what it wrote and what that took."""
    try:
        written = tyro.cli(main)
    except InputError as error:
        sys.exit(f"{error}")
    for path in written:
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
    print(f"{time.process_time():.0f} s of processor time")
