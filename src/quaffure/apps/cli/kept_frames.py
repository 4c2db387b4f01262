"""Frames of a drape that is being made, on the disk: memory does not grow, and an interrupted run continues."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from quaffure.apps.cli.console import console
from quaffure.drape_motion import FRAMES_AT_ONCE
from quaffure.io.frame_folder import FrameFolder
from quaffure.io.kept_folder import frames_path

KEPT_SECONDS = 20.0
"""An interrupted run that took less is made anew."""


@contextmanager
def kept_frames(output: Path, settings: dict[str, Any], resume: bool) -> Iterator[FrameFolder]:
    """A folder for frames, beside the output until the block ends well, and for `--resume` where it is interrupted.

    Args:
        settings: of the run, which an interrupted one must have had, too.

    Raises:
        InputError: as `FrameFolder`.
    """
    folder = FrameFolder(frames_path(output), settings, FRAMES_AT_ONCE, resume)
    before, start = len(folder), time.monotonic()
    if before:
        console.print(f"continuing after {before} frames of an interrupted run")
    elif folder.holds_frames:
        console.print(f"starting anew: --resume would have continued the frames in {folder.path}")
    try:
        yield folder
    except BaseException:
        is_new = len(folder) > before
        if len(folder) and (before or time.monotonic() - start >= KEPT_SECONDS):
            console.print(f"{len(folder)} frames kept in {folder.path}; the same command with --resume continues")
        elif is_new or not folder.holds_frames:
            folder.discard()
        folder.close()
        raise
    folder.discard()
