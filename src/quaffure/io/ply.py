"""Strands of one frame in Stanford's PLY: vertices, with the index of their strand, and the edges between them.

Metres, z up, as the drape. MeshLab and Blender show the edges; strands follow from the index, in the order of the file.
"""

from pathlib import Path

import numpy as np

from quaffure.hair.export_clip import ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_one_frame, check_suffix

PLY_SUFFIX = ".ply"
VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("strand", "<i4")])


def write_ply(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame.

    Raises:
        InputError: another suffix than .ply, more than one frame, or not writable.
    """
    check_suffix(path, PLY_SUFFIX)
    check_one_frame(path, len(clip.frames))
    strands = clip.strands(0)
    count, points = strands.shape[:2]
    vertices = np.empty(count * points, VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = strands[..., axis].ravel()
    vertices["strand"] = np.repeat(np.arange(count), points)
    first = np.arange(count * points, dtype="<i4").reshape(count, points)[:, :-1].ravel()
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"comment {count} strands of {points} vertices from root to tip, metres, z up\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\nproperty int strand\n"
        f"element edge {len(first)}\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(vertices.data)
        file.write(np.stack([first, first + 1], axis=1).astype("<i4").data)
