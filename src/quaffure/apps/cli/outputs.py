"""Output files of a drape; the suffix selects the format."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

from quaffure.apps.cli.console import progress_bar
from quaffure.apps.render.camera import AZIMUTHS
from quaffure.apps.render.framing import frames_of_picture
from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.export_clip import ExportClip, ExportSettings
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import groom_of_drape
from quaffure.hair.placed_clip import PlacedClip
from quaffure.io.output_path import check_distinct, check_no_inputs, check_one_frame, check_output
from quaffure.io.usd_layers import frame_layers

VIDEO = ".mp4"
PICTURES = (".png", VIDEO)
USD = (".usd", ".usda", ".usdc")
EXPORTS = (*USD, ".abc")
ONE_FRAME = (".hair", ".ply", ".data", ".bin")
SUFFIXES = (".npz", *EXPORTS, ".glb", *ONE_FRAME, *PICTURES)
EXTRA_OF = {**dict.fromkeys(PICTURES, "render"), **dict.fromkeys(USD, "usd"), ".abc": "alembic"}
SHOWN_BYTES = 2e8
LARGE_BYTES = 2e7
"""Size from which a file is printed with it: who writes a clip as meshes may not expect it."""
MOST_BYTES = 4e9
"""Limit of the frames that a format keeps in memory until they are written."""


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
    for path in files_of(paths):
        check_output(path, *SUFFIXES)
        check_packages(path)
    check_no_inputs(files_of(paths), inputs)
    check_distinct(files_of(paths))


def check_frames(
    paths: Sequence[Path],
    frames: range,
    settings: ExportSettings | None = None,
    inputs: Iterable[str | Path | None] = (),
) -> None:
    """Refuse more frames than a format takes, and files for parts of them, before the work for them.

    Args:
        frames: of the drape that are written.
        settings: how.
        inputs: as of `check_outputs`.

    Raises:
        InputError: more than one for a format of one frame, or a layer that is an input or another output.
    """
    for path in paths:
        if path.suffix.lower() in ONE_FRAME:
            check_one_frame(path, len(frames))
    layers = layers_of(paths, frames, settings or ExportSettings())
    check_no_inputs(layers, inputs)
    check_distinct([*files_of(paths), *layers])


def layers_of(paths: Iterable[Path], frames: range, settings: ExportSettings) -> list[Path]:
    """Files of ranges of frames, beside those of USD that name them.

    Args:
        frames: of the drape that are written.
    """
    if settings.frames_per_layer is None:
        return []
    usd = [path for path in paths if path.suffix.lower() in USD]
    return [each.path for path in usd for each in frame_layers(path, frames, settings.frames_per_layer)]


def files_of(paths: Iterable[Path]) -> list[Path]:
    """All files that are written for these outputs: an Alembic groom cache comes with its groom asset."""
    return [file for path in paths for file in ((path, asset_path(path)) if _is_alembic(path) else (path,))]


def written_text(paths: Iterable[Path], frames: range, settings: ExportSettings) -> str:
    """Names of all files that were written, and sizes of large ones.

    Args:
        frames: of the drape.
    """
    paths = [*paths]
    names, layers = [*map(_named, files_of(paths))], layers_of(paths, frames, settings)
    if layers:
        names.append(f"frames in {len(layers)} layers, {layers[0].name} to {layers[-1].name}")
    return ", ".join(names)


def _named(path: Path) -> str:
    size = path.stat().st_size if path.is_file() else 0
    return f"{path} ({size / 1e6:.0f} MB)" if size >= LARGE_BYTES else str(path)


def asset_path(path: Path) -> Path:
    """The file of the groom at rest beside an Alembic file of its animation: `walk_groom.abc` beside `walk.abc`."""
    return path.with_name(f"{path.stem}_groom{path.suffix}")


def check_packages(path: Path) -> None:
    """Raises:
    InputError: the packages that write the format of the suffix are not installed.
    """
    extra = EXTRA_OF.get(path.suffix.lower())
    if extra is not None:
        require_extra(extra, path)


def is_export(paths: Iterable[Path]) -> bool:
    """Whether one of them is written for other programs, which take groom and body at rest, or roots on its texture."""
    return any(path.suffix.lower() in (*EXPORTS, ".glb", ".ply") for path in paths)


def known_groom(sequence: DrapeSequence, body: BodyModel) -> Groom | None:
    """Groom of a drape file at rest; None where it is that of another body."""
    try:
        return groom_of_drape(sequence, body)
    except InputError:
        return None


def write_output(path: Path, clip: ExportClip, shows_progress: bool = True) -> None:
    """Write a drape in the format of the suffix: with an interpolation the strands between its guides, without one the
    guides. An .npz, which other commands read, always holds the guides. Each format's library is imported on first use.

    Args:
        shows_progress: whether how far it is, and how long the rest takes, is shown for pictures and videos.
    """
    check_packages(path)
    suffix = path.suffix.lower()
    if isinstance(clip, PlacedClip) and suffix not in USD:  # whose stages say which axis is up
        clip = replace(clip, is_z_up=True)
    if suffix == ".npz":
        from quaffure.io.drape_file import write_drape

        write_drape(path, clip.sequence, clip.file_arrays() if isinstance(clip, PlacedClip) else None)
    elif suffix == ".png":
        from quaffure.apps.render.pictures import write_picture

        views = len(AZIMUTHS) * len(frames_of_picture(len(clip.sequence)))
        with _parts_shown(path, views, shows_progress) as on_view:
            write_picture(path, clip.sequence, clip.interpolation, on_view)
    elif suffix == ".mp4":
        from quaffure.apps.render.video import write_video

        with _parts_shown(path, len(clip.sequence), shows_progress) as on_frame:
            write_video(path, clip.sequence, clip.interpolation, on_frame)
    elif suffix == ".abc":
        from quaffure.io.alembic_groom import write_groom_files

        with _progress(path, clip) as on_frame:
            write_groom_files(path, asset_path(path), clip, on_frame)
    elif suffix == ".glb":
        from quaffure.io.glb import write_glb

        with _progress(path, clip) as on_frame:
            write_glb(path, clip, on_frame)
    elif suffix == ".ply":
        from quaffure.io.ply import write_ply

        write_ply(path, clip)
    elif suffix == ".data":
        from quaffure.io.counted_writer import write_hairsalon

        write_hairsalon(path, clip)
    elif suffix == ".bin":
        from quaffure.io.counted_writer import write_ct2hair

        write_ct2hair(path, clip)
    elif suffix == ".hair":
        from quaffure.io.hair_writer import write_hair

        write_hair(path, clip)
    else:
        from quaffure.io.usd import write_usd

        if suffix == ".usda":
            _check_size(path, clip)
        with _progress(path, clip) as on_frame:
            write_usd(path, clip, on_frame)


def writing_text(path: Path, frames: int) -> str:
    """What is being written; of a picture, which frames it shows.

    Args:
        frames: of the drape.
    """
    if path.suffix.lower() != ".png":
        return f"writing {path}"
    *before, last = map(str, frames_of_picture(frames))
    shown = f"frames {', '.join(before)} and {last} of the drape's {frames}" if before else "the only frame"
    return f"writing {path}: {shown}, from {len(AZIMUTHS)} sides"


def _progress(path: Path, clip: ExportClip) -> AbstractContextManager[Callable[[], None]]:
    """Show the frames that are written, of a file that takes a while."""
    return _parts_shown(path, len(clip.frames), _size(clip) >= SHOWN_BYTES)


@contextmanager
def _parts_shown(path: Path, parts: int, is_shown: bool) -> Iterator[Callable[[], None]]:
    """Show how many parts of a file are written; yields what to call after each."""
    with progress_bar(f"writing {path.name}", parts, transient=True, disable=not is_shown) as update:
        yield lambda: update(advance=1)


def _is_alembic(path: Path) -> bool:
    return path.suffix.lower() == ".abc"


def _check_size(path: Path, clip: ExportClip) -> None:
    """Raises:
    InputError: more than a format may keep in memory.
    """
    needed = _size(clip)
    if needed > MOST_BYTES:
        raise InputError(path, f"at most {MOST_BYTES / 1e9:g} GB of strands in a text file", f"{needed / 1e9:.1f} GB")


def _size(clip: ExportClip) -> int:
    """Bytes of the strands of all frames."""
    return 12 * len(clip.frames) * clip.strand_count * clip.point_count
