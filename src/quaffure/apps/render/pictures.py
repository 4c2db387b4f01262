"""Still pictures: frames of a drape, and a groom before and after registration."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from quaffure.apps.render.camera import AZIMUTHS, Camera
from quaffure.apps.render.framing import MARGIN, facing_deg, frame_hair, frames_of_picture, hair_box
from quaffure.apps.render.scene import CHESTNUT, StrandRenderer
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_output

VIEWS_BEFORE_AFTER = ("front", "side", "back")
TILE = 512


class Subject(NamedTuple):
    """Strands to draw, alone or on a mesh.

    Attributes:
        strands: [m].
        vertices, faces: of a head or a body [m]; without them the strands alone are drawn.
        colour: of the hair, linear RGB.
    """

    strands: Float[np.ndarray, "s n 3"]
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]
    colour: tuple[float, float, float] = CHESTNUT

    @classmethod
    def without_mesh(cls, strands: Float[np.ndarray, "s n 3"]) -> "Subject":
        """The strands alone, with a face of no area in their middle."""
        return cls(strands, np.repeat(strands.mean(axis=(0, 1))[None], 3, axis=0), np.array([[0, 1, 2]]))


def write_picture(
    path: Path,
    seq: DrapeSequence,
    interpolation: GuideInterpolation | None = None,
    on_view: Callable[[], object] = lambda: None,
    tile: int = TILE,
) -> None:
    """Write a contact sheet (.png): a row for each of `frames_of_picture`, from front to back of the head.

    The cameras travel with the body.

    Args:
        interpolation: of strands between the drape's guides; without it the guides themselves are drawn.
        on_view: called after each of the views, `len(AZIMUTHS)` a frame.
        tile: width and height of one view [pixels].

    Raises:
        InputError: not a .png, not writable, or no OpenGL on this machine.
    """
    check_output(path, ".png")
    seq = seq.in_place()
    centre, extent = frame_hair(seq)
    with StrandRenderer(tile, tile) as renderer:
        rows = []
        for f in frames_of_picture(len(seq)):
            cameras = [Camera.view(view, centre, extent, facing_deg(seq, f)) for view in AZIMUTHS]
            rows.append(draw_frame(renderer, seq, f, interpolation, cameras, on_view))
    save_tiles(path, rows)


def frame_picture(
    seq: DrapeSequence, frame: int, view: str, interpolation: GuideInterpolation | None = None, size: int = TILE
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw one frame from one side of the head.

    Args:
        view: a key of `AZIMUTHS`.
        size: width and height [pixels].

    Raises:
        InputError: no such frame or view, or no OpenGL on this machine.
    """
    if not -len(seq) <= frame < len(seq):
        raise InputError("frame", f"one of {len(seq)}", f"{frame}")
    if view not in AZIMUTHS:
        raise InputError("view", f"one of {', '.join(AZIMUTHS)}", f"'{view}'")
    seq = seq.in_place()
    centre, extent = frame_hair(seq)
    with StrandRenderer(size, size) as renderer:
        camera = Camera.view(view, centre, extent, facing_deg(seq, frame))
        return draw_frame(renderer, seq, frame, interpolation, [camera])[0]


def draw_frame(
    renderer: StrandRenderer,
    seq: DrapeSequence,
    frame: int,
    interpolation: GuideInterpolation | None,
    cameras: Sequence[Camera],
    on_view: Callable[[], object] = lambda: None,
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Draw a frame by every camera: the strands between its guides, or without interpolation the guides.

    Args:
        on_view: called after each camera.
    """
    strands, body = seq.strands[frame], seq.body_vertices[frame]
    if interpolation is not None:
        strands = interpolation.strands(strands, body)
    views = []
    for camera in cameras:
        views.append(renderer.render(strands, body, seq.body_faces, camera))
        on_view()
    return views


def write_before_after(path: Path, *subjects: Subject, tile: int = TILE) -> None:
    """Write a picture (.png) of a column for each subject, from the front, the side and the back, in one scale.

    Args:
        tile: width and height of one view [pixels].

    Raises:
        InputError: not writable, or no OpenGL on this machine.
    """
    boxes = [hair_box(subject.strands, subject.vertices) for subject in subjects]
    extent = MARGIN * max(float((highest - lowest).max()) for lowest, highest in boxes)
    with StrandRenderer(tile, tile) as renderer:
        rows = [
            [
                renderer.render(
                    subject.strands,
                    subject.vertices,
                    subject.faces,
                    Camera.view(view, np.mean(box, axis=0), extent),
                    subject.colour,
                )
                for subject, box in zip(subjects, boxes)
            ]
            for view in VIEWS_BEFORE_AFTER
        ]
    save_tiles(path, rows)


def save_tiles(path: Path, rows: Iterable[Iterable[np.ndarray]]) -> None:
    """Write pictures of one size as the rows and columns of one .png."""
    save_png(path, Image.fromarray(np.vstack([np.hstack(list(row)) for row in rows])))


def save_png(path: Path, picture: Image.Image) -> None:
    """Write a picture.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    with replacing(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=9)
