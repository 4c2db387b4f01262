"""Strands of one frame in USC-HairSalon's `.data` and CT2Hair's `.bin`; `quaffure.io.counted_strands` describes them.

Y up and the face towards +z, as in those programs: (x, y, z) of the drape is (x, z, -y). `.data` is in metres. `.bin`
is in millimetres, with the direction away from the middle of all roots as the normal of each point, and the strand's
group as its label.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from quaffure.hair.export_clip import ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_one_frame, check_suffix

HAIRSALON_SUFFIX, CT2HAIR_SUFFIX = ".data", ".bin"
MILLIMETRES = 1e3


def write_hairsalon(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame, for USC-HairSalon.

    Raises:
        InputError: another suffix than .data, more than one frame, or not writable.
    """
    check_suffix(path, HAIRSALON_SUFFIX)
    check_one_frame(path, len(clip.frames))
    _write(path, _y_up(clip.points(0)), clip)


def write_ct2hair(path: Path, clip: ExportClip) -> None:
    """Write the strands of a clip of one frame, for CT2Hair.

    Raises:
        InputError: another suffix than .bin, more than one frame, or not writable.
    """
    check_suffix(path, CT2HAIR_SUFFIX)
    check_one_frame(path, len(clip.frames))
    points = clip.points(0)
    roots = points[np.cumsum(clip.counts) - clip.counts]
    outwards = points - roots.mean(axis=0)
    normals = outwards / np.linalg.norm(outwards, axis=1, keepdims=True).clip(min=1e-9)
    label = np.repeat(clip.groups, clip.counts)[:, None]
    _write(path, np.concatenate([MILLIMETRES * _y_up(points), _y_up(normals), label], axis=1), clip)


def _write(path: Path, rows: Float[np.ndarray, "p c"], clip: ExportClip) -> None:
    """Before each strand's rows of numbers stands how many they are."""
    columns = rows.shape[1]
    ends = columns * np.cumsum(clip.counts) + np.arange(1, clip.strand_count + 1)
    content = np.empty(rows.size + clip.strand_count, "<f4")
    heads = ends - columns * clip.counts - 1
    is_number = np.ones(len(content), bool)
    is_number[heads] = False
    content[is_number] = rows.ravel()
    content.view("<i4")[heads] = clip.counts
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(np.array(clip.strand_count, "<i4").tobytes())
        file.write(content.data)


def _y_up(vectors: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    x, y, z = vectors.T
    return np.stack([x, z, -y], axis=1)
