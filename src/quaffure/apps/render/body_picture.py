"""A picture of a body: its scalp from three sides, and its joints."""

import textwrap
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from quaffure.apps.render.camera import Camera
from quaffure.apps.render.pictures import save_png
from quaffure.apps.render.scene import StrandRenderer
from quaffure.body.body_model import BodyModel
from quaffure.geometry.mesh import face_normals
from quaffure.io.output_path import check_output

TILE = 400
SCALP_VIEWS, BODY_VIEWS = ("front", "side", "back"), ("front", "side")
HEAD_EXTENT = 0.34
BELOW_TOP = 0.13
"""Middle of a view of the head, below its top, for a view of `HEAD_EXTENT` [m]."""
MARK = 0.0015
"""Length of the strands that show the scalp, one on each of its triangles [m]."""
SCALP_COLOUR = (0.03, 0.12, 0.30)
FOUND, PLACED, PAPER, INK = (30, 140, 60), (230, 120, 20), (246, 246, 247), (38, 38, 42)
DOT, TEXT_SIZE, LINE, WIDTH_OF_TEXT = 4, 15, 20, 240
LEGEND = "Blue: scalp. Green: joints of the file. Orange: joints that were placed between them."


def write_body_picture(path: Path, body: BodyModel, notes: tuple[str, ...] = ()) -> None:
    """Write a picture (.png) of a body at rest, with notes below it.

    Raises:
        InputError: not a .png, not writable, or no OpenGL on this machine.
    """
    check_output(path, ".png")
    lines = [line for note in (LEGEND, *notes) for line in textwrap.wrap(note, WIDTH_OF_TEXT, break_long_words=True)]
    tiles = np.hstack(_tiles(body))
    sheet = Image.new("RGB", (tiles.shape[1], TILE + LINE * (len(lines) + 1)), PAPER)
    sheet.paste(Image.fromarray(tiles), (0, 0))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(TEXT_SIZE)
    for row, line in enumerate(lines):
        pen.text((10, TILE + LINE * (row + 0.5)), line, fill=INK, font=font)
    save_png(path, sheet)


def _tiles(body: BodyModel) -> list[UInt8[np.ndarray, "h w 3"]]:
    vertices, faces = body.rest_vertices.numpy(), body.faces.numpy()
    scalp = body.rest_vertices[body.faces[body.scalp.faces]]
    middles = scalp.mean(dim=1)
    marks = np.stack([middles.numpy(), (middles + MARK * face_normals(scalp)).numpy()], axis=1)
    lowest, highest = vertices.min(axis=0), vertices.max(axis=0)
    head = middles.numpy().mean(axis=0)
    extent = HEAD_EXTENT * max(1.0, float(np.ptp(middles.numpy(), axis=0).max()) / 0.2)
    head[2] = highest[2] - BELOW_TOP * extent / HEAD_EXTENT
    middle, size = 0.5 * (lowest + highest), 1.05 * float((highest - lowest).max())
    with StrandRenderer(TILE, TILE) as renderer:
        near = [Camera.view(view, head, extent) for view in SCALP_VIEWS]
        whole = [Camera.view(view, middle, size) for view in BODY_VIEWS]
        heads = [renderer.render(marks, vertices, faces, camera, SCALP_COLOUR) for camera in near]
        bodies = [renderer.render(marks, vertices, faces, camera, SCALP_COLOUR) for camera in whole]
    return [*heads, *(_with_joints(picture, body, camera) for picture, camera in zip(bodies, whole))]


def _with_joints(picture: UInt8[np.ndarray, "h w 3"], body: BodyModel, camera: Camera) -> UInt8[np.ndarray, "h w 3"]:
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    places = _pixels(body.rest_joints.double().numpy(), camera)
    found = [True] * len(places) if body.origin is None else [bool(node) for node in body.origin.joint_nodes]
    for joint, parent in enumerate(body.joint_parents):
        if parent >= 0:
            pen.line([*places[parent], *places[joint]], fill=INK, width=1)
    for place, is_found in zip(places, found):
        pen.ellipse([*(place - DOT), *(place + DOT)], fill=FOUND if is_found else PLACED, outline=INK)
    return np.asarray(image)


def _pixels(points: Float[np.ndarray, "p 3"], camera: Camera) -> Float[np.ndarray, "p 2"]:
    clip = np.pad(points, ((0, 0), (0, 1)), constant_values=1.0) @ camera.clip_from_world(TILE, TILE, 2.0).T
    return 0.5 * TILE * (1 + clip[:, :2] / clip[:, 3:] * [1, -1])
