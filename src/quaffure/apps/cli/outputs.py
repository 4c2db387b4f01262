"""Writers of drapes by suffix of the file; each imports its library only when it is called."""

from collections.abc import Callable
from pathlib import Path

from quaffure.apps.output_path import check_output
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation, with_strands

Writer = Callable[[Path, DrapeSequence, GuideInterpolation | None], None]

MOST_BYTES = 4e9
"""Limit of the strands in memory that a file is written from."""


def writer_for(path: Path) -> Writer:
    """The function that writes a drape to files of this suffix: with an interpolation the strands between its guides,
    without one the guides. An .npz, which other commands read, always holds the guides.

    Raises:
        InputError: no writer knows the suffix, or the folder does not exist.
    """
    check_output(path, *WRITERS)
    return WRITERS[path.suffix.lower()]


def _write_npz(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    from quaffure.io.drape_file import write_drape

    write_drape(path, sequence)


def _write_usd(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    from quaffure.io.usd import write_usd

    if interpolation is not None:
        bytes_of_strand = 2 * 12 * len(sequence) * interpolation.vertex_count
        if bytes_of_strand * len(interpolation) > MOST_BYTES:
            most = int(MOST_BYTES / bytes_of_strand)
            found = f"{len(interpolation)}"
            raise InputError("--strands", f"at most {most} for {len(sequence)} frames of USD", found)
        sequence = with_strands(sequence, interpolation)
    write_usd(path, sequence)


def _write_png(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    from quaffure.apps.render.pictures import write_picture

    write_picture(path, sequence, interpolation=interpolation)


def _write_mp4(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    from quaffure.apps.render.video import write_video

    write_video(path, sequence, interpolation=interpolation)


WRITERS: dict[str, Writer] = {
    ".npz": _write_npz,
    ".usd": _write_usd,
    ".usda": _write_usd,
    ".usdc": _write_usd,
    ".png": _write_png,
    ".mp4": _write_mp4,
}
