"""Small files of strands as our own writers make them, with the attributes of strands: colours, widths, ids, groups."""

from functools import cache
from pathlib import Path

import numpy as np
import torch

from quaffure.body import load_body
from quaffure.hair import ExportClip, ExportSettings, Groom
from quaffure.io import alembic_groom, counted_writer, hair_writer, ply
from tests.export_clips import export_clip
from tests.training_runs import tiny_groom

WRITERS = {
    ".abc": alembic_groom.write_groom_asset,
    ".bin": counted_writer.write_ct2hair,
    ".data": counted_writer.write_hairsalon,
    ".hair": hair_writer.write_hair,
    ".ply": ply.write_ply,
}


def write_strands(path: Path) -> None:
    """Four strands of five vertices, in the format of the suffix."""
    WRITERS[path.suffix](path, _clip())


def ply_of_properties() -> bytes:
    """A text with normals, whole-number colours, and the strand of each vertex."""
    names = ("x", "y", "z", "nx", "ny", "nz")
    header = [f"property float {name}" for name in names] + ["property uchar red", "property uchar green"]
    header += ["property uchar blue", "property int strand_id", "end_header"]
    rows = np.arange(6 * 10).reshape(6, 10)
    rows[:, 9] = [0, 0, 0, 4, 4, 4]
    lines = [*header, *(" ".join(map(str, row)) for row in rows), ""]
    return "\n".join(["ply", "format ascii 1.0", "comment strands", "element vertex 6", *lines]).encode()


def ply_heads() -> tuple[bytes, bytes]:
    """A tetrahedron with a quadrangle, as text and in little-endian order with colours."""
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 4, 2, 3))
    axes = "element vertex 5\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    lists = "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    points = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in corners)
    rows = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    kind = np.dtype([("at", "<f4", 3), ("colour", "u1", 3)])
    vertices = np.zeros(5, kind)
    vertices["at"] = corners
    content = f"ply\nformat binary_little_endian 1.0\n{axes}{colours}{lists}".encode() + vertices.tobytes()
    content += b"".join(bytes([len(face)]) + np.array(face, "<i4").tobytes() for face in faces)
    return f"ply\nformat ascii 1.0\n{axes}{lists}{points}{rows}".encode(), content


@cache
def whole_groom() -> Groom:
    return tiny_groom(load_body())


@cache
def _clip() -> ExportClip:
    body = load_body()
    groom = whole_groom()
    few = groom.select(torch.arange(0, len(groom), len(groom) // 4)[:4])
    return export_clip(few, body, settings=ExportSettings(points=5, every=10))
