"""Which writer a suffix picks; each loads its library only when it is asked for."""

from collections.abc import Callable
from pathlib import Path

from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation, with_strands
from quaffure.io.atomic import check_folder_of

Writer = Callable[[Path, DrapeSequence, GuideInterpolation | None], None]

MOST_BYTES = 4e9
"""Of strands that a file is written from at once."""


def writer_for(path: Path) -> Writer:
    """The function that writes a drape to files of this suffix: the strands between its guides where it is given an
    interpolation, else the guides. An .npz, which keeps the drape for other steps, holds the guides in either case.

    Raises:
        InputError: no writer knows the suffix, or the folder does not exist.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(path, f"an output of suffix {', '.join(WRITERS)}", f"suffix '{path.suffix}'")
    check_folder_of(path)
    return writer


def check_out(path: Path, suffix: str) -> None:
    """Refuse an output before the work and not after it.

    Raises:
        InputError: another suffix, no folder to write into, or a folder of that name.
    """
    if path.suffix.lower() != suffix:
        raise InputError(path, f"an output of suffix {suffix}", f"suffix '{path.suffix}'")
    check_folder_of(path)


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
