"""Pictures of the live page's drape from the camera of a browser, by the renderer."""

import io
from typing import NamedTuple

import numpy as np

from quaffure.apps.viewer.view_state import Drape
from quaffure.extras import require_extra
from quaffure.hair.guide_interpolation import GuideInterpolation

LONGER_SIDE = 1000
"""Pixels of a picture. The browser's own are fewer while it is slow, as viser lowers its resolution."""


class BrowserCamera(NamedTuple):
    """Camera of a browser.

    Attributes:
        position: [m].
        look_at: the point in the middle of the picture [m].
        field_of_view: from its upper to its lower edge [rad].
        width, height: of its picture [pixels].
    """

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]
    field_of_view: float
    width: int
    height: int


def png_of(drape: Drape, interpolation: GuideInterpolation | None, seen_by: BrowserCamera) -> bytes:
    """A drape as the camera of a browser shows it, as a .png of the same shape.

    Args:
        interpolation: of strands between the guides; without it the guides are drawn.

    Raises:
        InputError: missing packages, or no OpenGL on this machine.
    """
    require_extra("render", "a picture")
    from PIL import Image

    from quaffure.apps.render.camera import Camera
    from quaffure.apps.render.scene import StrandRenderer

    scale = LONGER_SIDE / max(seen_by.width, seen_by.height, 1)
    width, height = (max(1, round(scale * side)) for side in (seen_by.width, seen_by.height))
    tangent = np.tan(0.5 * seen_by.field_of_view) * min(1.0, width / height)
    camera = Camera(seen_by.position, seen_by.look_at, float(2.0 * np.arctan(tangent)))
    strands, body = drape.strands, drape.body_vertices
    if interpolation is not None:
        strands = interpolation.strands(strands, body)
    step = drape.path.astype(np.float32)
    with StrandRenderer(width, height) as renderer:
        pixels = renderer.render(strands - step, body - step, drape.sequence.body_faces, camera)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()
