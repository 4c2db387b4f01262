"""What notebooks show of a groom and of a drape: a small picture where the renderer is installed, and a line of text.

A notebook calls `_repr_html_` of a value (IPython's rich display); `Groom` and `DrapeSequence` call these functions.
"""

import base64
import io
from collections.abc import Sequence
from dataclasses import replace
from html import escape

import numpy as np

from quaffure.body.body_model import BodyModel, load_body
from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import groom_of_drape, shown_between

TILE = 256  # pixels
VIEWS = ("front", "3/4", "back")
MOST_FRAMES = 3
JPEG_QUALITY = 88
FARTHEST_ROOT = 0.02  # m: a groom whose roots are further from the shipped body's scalp is that of another body


def html_of_groom(groom: Groom) -> str:
    """A groom at rest from three sides, on the bundled body where it is its own."""
    shortest, longest = (100.0 * float(groom.strand_lengths.quantile(share)) for share in (0.05, 0.95))
    text = f"<b>{escape(groom.name)}</b>: {len(groom):,} strands of {groom.rest_strands.shape[1]} vertices, "
    text += f"most of them {shortest:.0f} to {longest:.0f} cm long"
    if groom.licence:
        text += f"; {escape(groom.licence)}"
    try:
        return _html(_groom_tiles(groom), text)
    except InputError as error:
        return _text_alone(text, error)


def html_of_drape(sequence: DrapeSequence) -> str:
    """Up to three evenly spaced frames of a drape, from the front."""
    name, draper = (escape(str(sequence.meta.get(key, "hair"))) for key in ("groom", "draper"))
    frames, strands, vertices, _ = sequence.strands.shape
    text = f"<b>{name}</b>, draped by {draper}: {strands:,} strands of {vertices} vertices, "
    text += f"{frames} frames at {sequence.fps:g} a second"
    try:
        return _html(_drape_tiles(sequence), text)
    except InputError as error:
        return _text_alone(text, error)


def _groom_tiles(groom: Groom) -> list[np.ndarray]:
    require_extra("render", "a picture")
    from quaffure.apps.render.camera import Camera
    from quaffure.apps.render.framing import MARGIN, hair_box
    from quaffure.apps.render.pictures import Subject
    from quaffure.apps.render.scene import StrandRenderer

    groom, body = groom.to("cpu"), load_body()
    strands = groom.rest_strands.float().numpy()
    if _is_on(groom, body):
        interpolation, vertices = shown_between(groom, body), body.rest_vertices.numpy()
        if interpolation is not None:
            strands = interpolation.strands(strands, vertices)
        subject = Subject(strands, vertices, body.faces.numpy())
    else:
        subject = Subject.without_mesh(strands)
    lowest, highest = hair_box(subject.strands, subject.vertices)
    centre, extent = 0.5 * (lowest + highest), MARGIN * float((highest - lowest).max())
    cameras = [Camera.view(view, centre, extent) for view in VIEWS]
    with StrandRenderer(TILE, TILE) as renderer:
        return [renderer.render(subject.strands, subject.vertices, subject.faces, camera) for camera in cameras]


def _drape_tiles(sequence: DrapeSequence) -> list[np.ndarray]:
    require_extra("render", "a picture")
    from quaffure.apps.render.camera import Camera
    from quaffure.apps.render.framing import facing_deg, frame_hair
    from quaffure.apps.render.pictures import draw_frame
    from quaffure.apps.render.scene import StrandRenderer

    if not len(sequence):
        raise InputError("drape", "at least one frame", "none")
    count = min(MOST_FRAMES, len(sequence))
    shown = _select(sequence, np.linspace(0, len(sequence) - 1, count).round().astype(int)).in_place()
    try:
        body = load_body()
        interpolation = shown_between(groom_of_drape(shown, body), body)
    except InputError:  # the drape of another body
        interpolation = None
    centre, extent = frame_hair(shown)
    with StrandRenderer(TILE, TILE) as renderer:
        return [
            draw_frame(renderer, shown, f, interpolation, [Camera.view("front", centre, extent, facing_deg(shown, f))])[
                0
            ]
            for f in range(count)
        ]


def _select(sequence: DrapeSequence, frames: np.ndarray) -> DrapeSequence:
    """Frames of a drape; its arrays may be files, of which the other frames are not read."""
    translation = sequence.body_translation
    return replace(
        sequence,
        strands=sequence.strands[frames],
        posed=sequence.posed[frames],
        body_vertices=sequence.body_vertices[frames],
        body_pose=sequence.body_pose[frames],
        body_translation=None if translation is None else translation[frames],
    )


def _is_on(groom: Groom, body: BodyModel) -> bool:
    """Whether the roots of a groom are on this body at rest."""
    if int(groom.root_faces.max()) >= len(body.faces):
        return False
    corners = body.rest_vertices[body.faces[groom.root_faces]]
    roots = (groom.root_barycentric.float()[..., None] * corners).sum(-2)
    return float((roots - groom.rest_strands[:, 0].float()).norm(dim=-1).max()) < FARTHEST_ROOT


def _html(tiles: Sequence[np.ndarray], text: str) -> str:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.hstack(list(tiles))).save(file, format="JPEG", quality=JPEG_QUALITY)
    picture = base64.b64encode(file.getvalue()).decode()
    return f'<figure><img src="data:image/jpeg;base64,{picture}"><figcaption>{text}</figcaption></figure>'


def _text_alone(text: str, reason: InputError) -> str:
    return f"<p>{text}<br><small>{escape(str(reason))}</small></p>"
