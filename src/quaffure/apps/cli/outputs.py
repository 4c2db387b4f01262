"""Output files of a drape; the suffix selects the format."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation, with_strands
from quaffure.io.output_path import check_distinct, check_output

PICTURES = (".png", ".mp4")
SUFFIXES = (".npz", ".usd", ".usda", ".usdc", *PICTURES)
MOST_BYTES = 4e9
"""Limit of the strands in memory that a file is written from."""


def check_outputs(paths: Sequence[Path], inputs: Iterable[str | Path | None]) -> None:
    """Refuse files that could not be written, before the work for them.

    Args:
        inputs: what the command reads: files, and names that may be files.

    Raises:
        InputError: no file, a suffix that no format has, a folder that does not exist or is read-only, the same file
            twice, an input, or a format whose packages are not installed.
    """
    if not paths:
        raise InputError("--out", "at least one file to write", "none")
    for path in paths:
        check_output(path, *SUFFIXES, inputs=inputs)
        check_packages(path)
    check_distinct(paths)


def check_packages(path: Path) -> None:
    """Raises:
    InputError: the packages that write the format of the suffix are not installed.
    """
    suffix = path.suffix.lower()
    if suffix in PICTURES:
        require_extra("render", path)
    elif suffix != ".npz":
        require_extra("usd", path)


def write_output(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    """Write a drape in the format of the suffix: with an interpolation the strands between its guides, without one the
    guides. An .npz, which other commands read, always holds the guides. Each format's library is imported on first use.
    """
    check_packages(path)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        from quaffure.io.drape_file import write_drape

        write_drape(path, sequence)
    elif suffix == ".png":
        from quaffure.apps.render.pictures import write_picture

        write_picture(path, sequence, interpolation)
    elif suffix == ".mp4":
        from quaffure.apps.render.video import write_video

        write_video(path, sequence, interpolation)
    else:
        from quaffure.io.usd import write_usd

        write_usd(path, sequence if interpolation is None else _interpolated(sequence, interpolation))


def _interpolated(sequence: DrapeSequence, interpolation: GuideInterpolation) -> DrapeSequence:
    most = int(MOST_BYTES / (2 * 12 * len(sequence) * interpolation.vertex_count))
    if len(interpolation) > most:
        raise InputError("--strands", f"at most {most} for {len(sequence)} frames of USD", f"{len(interpolation)}")
    return with_strands(sequence, interpolation)
