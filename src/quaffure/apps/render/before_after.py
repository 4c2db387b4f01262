"""A groom as it came, beside the same groom on our body."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

from quaffure.apps.render.camera import Camera
from quaffure.apps.render.framing import MARGIN, hair_box
from quaffure.apps.render.scene import StrandRenderer
from quaffure.io.atomic import replacing

VIEWS = (Camera.front, Camera.side, Camera.back)
TILE = 512


@dataclass(frozen=True)
class Subject:
    """Strands to look at, on a mesh or on nothing.

    Attributes:
        strands: [m].
        vertices, faces: of a head or a body [m].
    """

    strands: Float[np.ndarray, "s n 3"]
    vertices: Float[np.ndarray, "v 3"] | None
    faces: Int[np.ndarray, "k 3"] | None


def write_before_after(path: Path, before: Subject, after: Subject, tile: int = TILE) -> None:
    """Write a picture (.png) of two columns, before and after, from the front, the side and the back, in one scale.

    Args:
        tile: width and height of one view [pixels].

    Raises:
        InputError: not writable, or no OpenGL on this machine.
    """
    boxes = [hair_box(subject.strands, _mesh(subject)[0]) for subject in (before, after)]
    extent = MARGIN * max(float((highest - lowest).max()) for lowest, highest in boxes)
    with replacing(path) as temporary, StrandRenderer(tile, tile) as renderer:
        rows = [
            np.hstack(
                [
                    renderer.render(subject.strands, *_mesh(subject), view(0.5 * (lowest + highest), extent))
                    for subject, (lowest, highest) in zip((before, after), boxes)
                ]
            )
            for view in VIEWS
        ]
        Image.fromarray(np.vstack(rows)).save(temporary, format="PNG", compress_level=9)


def _mesh(subject: Subject) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces; where there are none, a face of no area amid the strands."""
    if subject.vertices is None or subject.faces is None:
        return np.repeat(subject.strands.mean(axis=(0, 1))[None], 3, axis=0), np.array([[0, 1, 2]])
    return subject.vertices, subject.faces
