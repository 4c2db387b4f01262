"""A drape as a video."""

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from jaxtyping import UInt8

from quaffure.apps.render.camera import Camera
from quaffure.apps.render.framing import facing_deg, frame_hair
from quaffure.apps.render.pictures import draw_frame
from quaffure.apps.render.scene import StrandRenderer
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_output

Picture = UInt8[np.ndarray, "h w 3"]
VIEWS = ("front", "side")
TILE = 512
# Fewer samples a pixel than in a still picture: motion hides the difference.
SUPERSAMPLING = 3
CONSTANT_RATE_FACTOR = 20


def write_video(
    path: Path,
    seq: DrapeSequence,
    interpolation: GuideInterpolation | None = None,
    on_frame: Callable[[], object] = lambda: None,
    tile: int = TILE,
) -> None:
    """Write front and side views next to each other (.mp4, H.264).

    The camera travels with the body and does not turn; it faces the body as it stands in the middle frame.

    Args:
        interpolation: of strands between the drape's guides; without it the guides themselves are drawn.
        on_frame: called after each frame.
        tile: width and height of one view, even [pixels].

    Raises:
        InputError: not an .mp4, not writable, or no OpenGL on this machine.
    """
    seq = seq.in_place()
    centre, extent = frame_hair(seq)
    cameras = [Camera.view(view, centre, extent, facing_deg(seq, len(seq) // 2)) for view in VIEWS]

    def pictures() -> Iterator[Picture]:
        with StrandRenderer(tile, tile, supersampling=SUPERSAMPLING) as renderer:
            for frame in range(len(seq)):
                yield np.hstack(draw_frame(renderer, seq, frame, interpolation, cameras))
                on_frame()

    encode_video(path, pictures(), seq.fps)


def encode_video(
    path: Path, pictures: Iterable[Picture], fps: float, constant_rate_factor: int = CONSTANT_RATE_FACTOR
) -> None:
    """Write pictures of one size as a video (.mp4, H.264), one at a time.

    Args:
        pictures: sRGB, even in height and width; at least one.
        constant_rate_factor: of x264, 0 to 51: a higher one makes a smaller file of lower quality.

    Raises:
        InputError: not an .mp4, not writable, no pictures, or an odd number of pixels.
    """
    check_output(path, ".mp4")
    with (
        replacing(path) as temporary,
        av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"}) as container,
    ):
        rate = Fraction(fps).limit_denominator(1001)
        stream = container.add_stream("libx264", rate=rate, options={"crf": str(constant_rate_factor)})
        stream.pix_fmt = "yuv420p"
        size: tuple[int, ...] = ()
        for picture in pictures:
            if not size:
                size = picture.shape[:2]
                if size[0] % 2 or size[1] % 2:
                    expected = "an even number of pixels, as H.264 stores colour at half size"
                    raise InputError(path, expected, f"{size[1]} x {size[0]}")
                stream.height, stream.width = size
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if not size:
            raise InputError(path, "at least one picture", "none")
        container.mux(stream.encode())
