"""A groom from whatever names one: a bundled style, a registered groom file, or strands of any supported format."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from quaffure.body.body_model import BodyModel, load_body
from quaffure.config import VERTICES_PER_STRAND
from quaffure.energies.held_parts import with_found_ties
from quaffure.errors import InputError
from quaffure.hair.file_frame import UNKNOWN, FileFrame
from quaffure.hair.folds import without_folds
from quaffure.hair.groom import Groom
from quaffure.hair.groom_transfer import transfer_groom
from quaffure.hair.registration import HeadMesh, register_groom
from quaffure.hair.registration_report import RegistrationReport
from quaffure.hair.scalp_texture import select_guides
from quaffure.hair.source_strands import PlacedStrands, place_strands
from quaffure.hair.strands import Strands
from quaffure.input_file import did_you_mean, read_text
from quaffure.io.groom_file import is_groom_file, read_groom, read_source
from quaffure.io.ply_strands import read_ply_mesh
from quaffure.io.read_strands import read_strands
from quaffure.procedural.generator import make_groom
from quaffure.procedural.hair_style import STYLES


def load_groom(
    groom: str | Path,
    body: BodyModel | None = None,
    head: Path | None = None,
    frame: FileFrame = UNKNOWN,
    on_report: Callable[[RegistrationReport], object] = lambda report: None,
) -> Groom:
    """A groom on `body`, 24 vertices a strand, at most one strand in a texel of the scalp's texture.

    Args:
        groom: a bundled name (`STYLES`), or the path of a groom file or of a strand file.
        body: the shipped one where none is given.
        head: the mesh (.obj, .ply) of the head that a strand file's hair belongs to, in the same units and axes.
        frame: what is known of a strand file's axes and unit.
        on_report: called with what was guessed and found when a strand file was registered.

    Raises:
        InputError: no such name or file, a broken file, or strands that cannot be registered.
    """
    body = body or load_body()
    if isinstance(groom, str) and groom in STYLES:
        _check_no_head(head, f"the bundled groom {groom}")
        return make_groom(groom, body)
    path = Path(groom)
    # Not Path.exists, which raises where the text is longer than a name can be.
    if not os.path.exists(path) and not path.suffix:
        names = sorted(STYLES)
        raise InputError(
            groom, f"a bundled groom ({', '.join(names)}) or a file", f"neither{did_you_mean(path, names)}"
        )
    if is_groom_file(path):
        _check_no_head(head, f"the groom file {path}")
        loaded = _read_groom(path, body)
        if loaded.rest_strands.shape[1] != VERTICES_PER_STRAND:
            found = f"{loaded.rest_strands.shape[1]}"
            raise InputError(path, f"{VERTICES_PER_STRAND} vertices a strand", found)
        return _opened(select_guides(loaded))
    mesh = read_head(head) if head is not None else None
    registered, _, report = register_strands(read_strands(path), body, path.stem, mesh, frame)
    registered, ties = with_found_ties(registered)
    on_report(replace(report, ties=ties))
    return _opened(select_guides(registered))


def _check_no_head(head: Path | None, groom: str) -> None:
    if head is not None:
        raise InputError(head, "no head mesh with a groom that is registered already", groom)


def _read_groom(path: Path, body: BodyModel) -> Groom:
    """A groom file of this body, or for an imported body one of the shipped body."""
    try:
        return read_groom(path, body)
    except InputError:
        if body.origin is None:
            raise
    return transfer_groom(read_groom(path, load_body()), load_body(), body)


def _stands_on(path: Path, body: BodyModel) -> bool:
    try:
        read_groom(path, body)
    except InputError:
        return False
    return True


def register_strands(
    strands: Strands, body: BodyModel, name: str, head: HeadMesh | None, frame: FileFrame
) -> tuple[Groom, Strands, RegistrationReport]:
    """Strands on a body, as they were registered, and the report of it: on an imported body those that were made on its
    character stay where they are.

    Raises:
        InputError: as `register_groom`.
    """
    if body.origin is not None and head is None and frame == UNKNOWN:
        points = body.origin.body_from_file(strands.points).astype(np.float32)
        standing = replace(strands, points=points, attributes=strands.attributes.scaled(1 / body.origin.scale))
        try:
            groom, report = register_groom(standing, body, name, frame=FileFrame(registered=True))
            return groom, standing, report
        except InputError:
            pass
    groom, report = register_groom(strands, body, name, head, frame=frame)
    return groom, strands, report


def load_source(
    groom: str | Path, body: BodyModel, head: Path | None = None, frame: FileFrame = UNKNOWN
) -> PlacedStrands:
    """All strands that a groom was registered from, where they are on `body`.

    Args:
        groom, head, frame: as for `load_groom`.

    Raises:
        InputError: a bundled name, or a groom file without its source or of another body; otherwise as `load_groom`.
    """
    path, expected = Path(groom), "a strand file, or a groom file that quaffure groom import wrote"
    if isinstance(groom, str) and groom in STYLES:
        raise InputError(groom, expected, "a bundled groom, which has no strands but the draped ones")
    if is_groom_file(path):
        source = read_source(path)
        if source is None:
            raise InputError(path, expected, "a groom file without its source")
        if body.origin is not None and not _stands_on(path, body):
            raise InputError(path, "the strand file itself", "a groom file of another body, whose source stays on it")
        return source
    mesh = read_head(head) if head is not None else None
    _, strands, report = register_strands(read_strands(path), body, path.stem, mesh, frame)
    return place_strands(strands, report, body)


def _opened(groom: Groom) -> Groom:
    """The groom without folds, at which no rod can rest."""
    strands = without_folds(groom.rest_strands)
    return groom if strands is groom.rest_strands else replace(groom, rest_strands=strands)


def read_head(path: str | Path) -> HeadMesh:
    """Vertices and triangles of a Wavefront `.obj` or a `.ply`; polygons are fanned, everything else is skipped.

    Raises:
        InputError: no such file, one of another suffix, or no mesh in it.
    """
    path = Path(path)
    readers = {".obj": _obj_mesh, ".ply": _ply_mesh}
    if path.suffix.lower() not in readers:
        raise InputError(path, "a head mesh (.obj, .ply)", f"suffix '{path.suffix}'")
    points, faces = readers[path.suffix.lower()](path)
    if not len(faces) or faces.min() < 0 or faces.max() >= len(points):
        raise InputError(path, "a mesh of vertices and faces", f"{len(points)} vertices, {len(faces)} faces")
    if not np.isfinite(points).all():
        raise InputError(path, "finite vertices", "NaN or infinity")
    return HeadMesh(points, faces)


def _ply_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    points, polygons = read_ply_mesh(path)
    faces = [(row[0], row[k], row[k + 1]) for row in polygons for k in range(1, len(row) - 1)]
    return points, np.array(faces, dtype=np.int64).reshape(-1, 3)


def _obj_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    lines = read_text(path, "a head mesh (.obj)", errors="replace").splitlines()
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    try:
        for words in (line.split() for line in lines):
            if words[:1] == ["v"]:
                vertices.append([float(word) for word in words[1:4]])
            elif words[:1] == ["f"]:
                faces += _fan([int(word.split("/")[0]) for word in words[1:]], len(vertices))
        corners = np.array(faces, dtype=np.int64).reshape(-1, 3)
    except (ValueError, OverflowError) as error:
        raise InputError(path, "numbers in the v and f lines of an .obj", str(error)) from error
    points = np.array([vertex for vertex in vertices if len(vertex) == 3]).reshape(-1, 3)
    if len(points) != len(vertices):
        raise InputError(path, "a mesh of vertices and faces", f"{len(points)} vertices, {len(faces)} faces")
    return points, corners


def _fan(indices: list[int], vertex_count: int) -> list[tuple[int, int, int]]:
    """Triangles of a polygon; .obj counts from 1, or back from the last vertex with negative numbers."""
    corners = [index - 1 if index > 0 else vertex_count + index for index in indices]
    return [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
