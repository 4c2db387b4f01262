"""A clip in a line of Python: draped, written, drawn; what `quaffure drape` does without its reports."""

from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.body.pose_limits import SHAPE_COUNT, Rows
from quaffure.drape_motion import drape_motion
from quaffure.draper import Draper
from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import groom_of_drape, interpolation_of, shown_between
from quaffure.solvers.coherent_clip import CoherentDraper

if TYPE_CHECKING:
    from PIL.Image import Image

PICTURE_SIZES = range(16, 8193)
"""Widths of pictures [pixels]."""


def drape_clip(
    groom: Groom,
    motion: Motion,
    body_shape: Rows | None = None,
    draper: Draper | None = None,
    body: BodyModel | None = None,
) -> DrapeSequence:
    """A groom on a body in every frame of a motion.

    Args:
        body_shape: beta [10], a tensor, an array or a list [standard deviations]; the mean body by default.
        draper: `CoherentDraper()` by default, which lets hair follow from frame to frame.
        body: that groom and motion were loaded for; the shipped one by default.

    Raises:
        InputError: a groom or a shape that cannot be draped, or a name in place of what is loaded by it.
    """
    draper = draper or CoherentDraper()
    for found, kind, call in (
        (groom, Groom, "quaffure.load_groom(name)"),
        (motion, Motion, "quaffure.load_motion(name)"),
        (draper, Draper, "quaffure.load_model().draper"),
    ):
        if not isinstance(found, kind):
            raise InputError(kind.__name__.lower(), f"a {kind.__name__}, such as {call}", f"{found!r:.60}")
    shape = torch.zeros(SHAPE_COUNT) if body_shape is None else body_shape
    return drape_motion(draper, groom, body or load_body(), motion, shape)


def save_drape(
    sequence: DrapeSequence,
    path: str | Path,
    strands: int | None = None,
    body: BodyModel | None = None,
    motion: str | Path = "",
) -> None:
    """Write a drape as the suffix says: .npz, .usd, .usda, .usdc, .abc, .glb, .png, .mp4, and of one frame .hair, .ply.

    Args:
        strands: to interpolate between the draped ones; an .npz always holds the draped ones. Without it, pictures show
            12,000, videos 6,000, and other files have the draped ones.
        body: of the drape; the shipped one by default. Files of an imported one are in the scene of its character.
        motion: the character's file and clip that the drape is of (`FILE.glb#NAME`); its skin then moves the roots.

    Raises:
        InputError: no drape of `drape_clip`, another suffix, a missing package, or not writable.
    """
    _check_drape(sequence)
    from quaffure.apps.cli.outputs import (
        PICTURES,
        VIDEO,
        check_frames,
        check_outputs,
        is_export,
        known_groom,
        write_output,
    )
    from quaffure.hair.export_clip import ExportClip
    from quaffure.hair.groom_binding import groom_binding
    from quaffure.hair.placed_clip import placed_clip
    from quaffure.io.character_scene import read_character_space

    path, body = Path(path), body or load_body()
    if motion and body.origin is None:
        raise InputError("motion", "the body of the character whose file it is", f"{motion} on the shipped body")
    check_outputs((path,), (motion,))
    check_frames((path,), range(len(sequence)))
    is_bound = is_export((path,)) or body.origin is not None
    groom = known_groom(sequence, body) if is_bound else None
    interpolation = None
    if strands is not None:
        interpolation = interpolation_of(groom_of_drape(sequence, body), body, strands)
    elif path.suffix.lower() in PICTURES:
        interpolation = shown_between(groom_of_drape(sequence, body), body, path.suffix.lower() == VIDEO)
    binding = None if groom is None else groom_binding(groom, body, torch.from_numpy(sequence.body_shape))
    clip = ExportClip(sequence, interpolation, binding)
    space = read_character_space(body, motion, sequence.times)
    write_output(path, clip if space is None else placed_clip(clip, space))


def draw(
    sequence: DrapeSequence, frame: int = 0, view: str = "front", size: int = 512, body: BodyModel | None = None
) -> "Image":
    """A frame as a picture, which notebooks show by themselves.

    Args:
        view: front, 3/4, side or back.
        size: width and height [pixels].
        body: of the drape; the shipped one by default.

    Raises:
        InputError: no drape of `drape_clip`, a frame that it has not, a size out of `PICTURE_SIZES`, missing packages,
            or no OpenGL on this machine.
    """
    _check_drape(sequence)
    if not (isinstance(frame, Integral) and -len(sequence) <= frame < len(sequence)):
        raise InputError("frame", f"a whole number from 0 to {len(sequence) - 1}", f"{frame!r}")
    if not (isinstance(size, Integral) and size in PICTURE_SIZES):
        raise InputError("size", f"{PICTURE_SIZES[0]} to {PICTURE_SIZES[-1]} pixels", f"{size!r}")
    require_extra("render", "draw")
    from PIL import Image

    from quaffure.apps.render.pictures import frame_picture

    body = body or load_body()
    interpolation = shown_between(groom_of_drape(sequence, body), body)
    return Image.fromarray(frame_picture(sequence, frame, view, interpolation, size))


def _check_drape(sequence: object) -> None:
    """`Quaffure.drape` returns a tensor, which lacks the body that is drawn and written with the hair."""
    if not isinstance(sequence, DrapeSequence):
        expected = "a DrapeSequence, as quaffure.drape_clip(groom, motion, draper=model.draper) returns"
        raise InputError("drape", expected, f"a {type(sequence).__name__}")
