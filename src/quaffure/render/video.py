"""A drape as a video."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from quaffure.errors import InputError
from quaffure.groom.drape_sequence import DrapeSequence
from quaffure.groom.guide_interpolation import GuideInterpolation
from quaffure.io.atomic import replacing
from quaffure.render.camera import Camera
from quaffure.render.framing import drawn_strands, facing_deg, frame_hair
from quaffure.render.scene import CHESTNUT, StrandRenderer

VIEWS = (Camera.front, Camera.side)
TILE = 512
# Motion hides what a still would show: fewer samples a pixel than in a picture.
SUPERSAMPLING = 3
CONSTANT_RATE_FACTOR = 20


def write_video(
    path: Path,
    seq: DrapeSequence,
    hair_colour: tuple[float, float, float] = CHESTNUT,
    tile: int = TILE,
    on_frame: Callable[[int], None] | None = None,
    interpolation: GuideInterpolation | None = None,
) -> None:
    """Write front and side views next to each other (.mp4, H.264).

    The camera stands still, facing where the body faces half way.

    Args:
        hair_colour: albedo in linear RGB.
        tile: width and height of one view, even [pixels].
        on_frame: called with the number of frames written so far.
        interpolation: of strands between the drape's guides; without it the guides themselves are drawn.

    Raises:
        InputError: not an .mp4, not writable, or no OpenGL on this machine.
    """
    if path.suffix.lower() != ".mp4":
        raise InputError(path, "a video's name ending in .mp4", f"{path.suffix or 'no suffix'}")
    if tile % 2:
        raise InputError("tile", "an even number of pixels, as H.264 stores colour at half size", str(tile))
    centre, extent = frame_hair(seq)
    cameras = [view(centre, extent, facing_deg(seq, len(seq) // 2)) for view in VIEWS]
    with (
        replacing(path) as temporary,
        StrandRenderer(tile, tile, supersampling=SUPERSAMPLING) as renderer,
        av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"}) as container,
    ):
        stream = container.add_stream(
            "libx264", rate=Fraction(seq.fps).limit_denominator(1001), options={"crf": str(CONSTANT_RATE_FACTOR)}
        )
        stream.width, stream.height, stream.pix_fmt = tile * len(VIEWS), tile, "yuv420p"
        for done, body in enumerate(seq.body_vertices, start=1):
            strands = drawn_strands(seq, done - 1, interpolation)
            views = [renderer.render(strands, body, seq.body_faces, camera, hair_colour) for camera in cameras]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.hstack(views), format="rgb24")))
            if on_frame is not None:
                on_frame(done)
        container.mux(stream.encode())
