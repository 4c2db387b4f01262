"""Writers of drapes by suffix of the file; each imports its library only when it is called."""

from collections.abc import Callable, Sequence
from pathlib import Path

from quaffure.apps.output_path import check_output
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation, with_strands

Writer = Callable[[Path, DrapeSequence, GuideInterpolation | None], None]

MOST_BYTES = 4e9
"""Limit of the strands in memory that a file is written from."""


def writers_for(paths: Sequence[Path]) -> list[tuple[Path, Writer]]:
    """Each file with the function that writes a drape to it: with an interpolation the strands between its guides,
    without one the guides. An .npz, which other commands read, always holds the guides.

    Raises:
        InputError: no file, no writer for a suffix, or a folder that does not exist.
    """
    if not paths:
        raise InputError("--out", "at least one file to write", "none")
    for path in paths:
        check_output(path, *WRITERS)
    return [(path, WRITERS[path.suffix.lower()]) for path in paths]


def _write_npz(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    from quaffure.io.drape_file import write_drape

    write_drape(path, sequence)


def _write_usd(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    from quaffure.io.usd import write_usd

    if interpolation is not None:
        most = int(MOST_BYTES / (2 * 12 * len(sequence) * interpolation.vertex_count))
        if len(interpolation) > most:
            raise InputError("--strands", f"at most {most} for {len(sequence)} frames of USD", f"{len(interpolation)}")
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
