"""Strands of one frame in Stanford's PLY: vertices, with the index of their strand, and the edges between them.

Metres, z up, as the drape. MeshLab and Blender show the edges; strands follow from the index, in the order of the file.
"""

from pathlib import Path

import numpy as np

from quaffure.hair.export_clip import ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_one_frame, check_suffix

PLY_SUFFIX = ".ply"
COLOUR = ("red", "green", "blue")
VERTEX = np.dtype([*((axis, "<f4") for axis in "xyz"), ("strand", "<i4"), *((name, "u1") for name in COLOUR)])


def write_ply(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame.

    Raises:
        InputError: another suffix than .ply, more than one frame, or not writable.
    """
    check_suffix(path, PLY_SUFFIX)
    check_one_frame(path, len(clip.frames))
    points, counts = clip.points(0), clip.counts
    vertices = np.empty(len(points), VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = points[:, axis]
    for channel, name in enumerate(COLOUR):
        vertices[name] = np.rint(255 * clip.colours[:, channel].clip(0, 1))
    vertices["strand"] = np.repeat(np.arange(len(counts)), counts)
    is_last = np.zeros(len(points), bool)
    is_last[np.cumsum(counts) - 1] = True
    first = np.flatnonzero(~is_last)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"comment {len(counts)} strands from root to tip, metres, z up\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\nproperty int strand\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element edge {len(first)}\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(vertices.data)
        file.write(np.stack([first, first + 1], axis=1).astype("<i4").data)
