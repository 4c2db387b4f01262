"""Layers of a USD file that hold its frames, a range each, for long shots."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FrameLayer:
    """A file for a range of frames.

    Attributes:
        path: of the file.
        frames: of the drape that it holds.
    """

    path: Path
    frames: Sequence[int]


def frame_layers(path: Path, frames: Sequence[int], frames_per_layer: int) -> list[FrameLayer]:
    """The layers of a USD file, beside it and named after it and their first frame.

    Args:
        path: of the file.
        frames: of the drape that are written.
        frames_per_layer: how many of them a layer holds; the last one may have fewer.
    """
    parts = [frames[start : start + frames_per_layer] for start in range(0, len(frames), frames_per_layer)]
    digits = max(4, len(str(frames[-1])))
    return [FrameLayer(path.with_name(f"{path.stem}.{part[0]:0{digits}}{path.suffix}"), part) for part in parts]
