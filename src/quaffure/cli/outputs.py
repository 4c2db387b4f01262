"""Which writer a suffix picks; each loads its library only when it is asked for."""

from collections.abc import Callable
from pathlib import Path

from quaffure.errors import InputError
from quaffure.groom.drape_sequence import DrapeSequence


def writer_for(path: Path) -> Callable[[Path, DrapeSequence], None]:
    """The function that writes a drape to files of this suffix.

    Raises:
        InputError: no writer knows the suffix, or the folder does not exist.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(path, f"an output of suffix {', '.join(WRITERS)}", f"suffix '{path.suffix}'")
    if not path.parent.is_dir():
        raise InputError(path, "a path in an existing folder", f"no folder {path.parent}")
    if path.is_dir():
        raise InputError(path, "a file to write", "a folder")
    return writer


def _write_npz(path: Path, sequence: DrapeSequence) -> None:
    from quaffure.io.drape_file import write_drape

    write_drape(path, sequence)


def _write_usd(path: Path, sequence: DrapeSequence) -> None:
    from quaffure.io.usd import write_usd

    write_usd(path, sequence)


def _write_png(path: Path, sequence: DrapeSequence) -> None:
    from quaffure.render.pictures import write_picture

    write_picture(path, sequence)


def _write_mp4(path: Path, sequence: DrapeSequence) -> None:
    from quaffure.render.video import write_video

    write_video(path, sequence)


WRITERS: dict[str, Callable[[Path, DrapeSequence], None]] = {
    ".npz": _write_npz,
    ".usd": _write_usd,
    ".usda": _write_usd,
    ".usdc": _write_usd,
    ".png": _write_png,
    ".mp4": _write_mp4,
}
