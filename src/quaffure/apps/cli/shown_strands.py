"""Which strands are shown with a drape: more between the draped ones, or those of the groom's source."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

from quaffure.apps.cli.console import console
from quaffure.apps.cli.outputs import PICTURES, VIDEO
from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.hair.export_clip import ExportClip
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import GuideInterpolation, interpolation_of, shown_between
from quaffure.hair.source_strands import original_strands
from quaffure.io.load_groom import load_groom, load_source

ORIGINAL, GUIDES = "original", "guides"
OPTION = "--strands"
FEW_GUIDES = 500
"""Fewer guides than these are too far apart for strands between them to look like hair."""
SAME_STRAND = 1e-3
"""Largest distance of roots, and difference of lengths, of one strand of a drape and of its groom [m]."""


def strands_between(
    strands: str | None, source: str, groom: Groom, body: BodyModel, head: Path | None = None
) -> GuideInterpolation | None:
    """Strands of a drape by a number of them, or `ORIGINAL`; None for the draped ones, `GUIDES`.

    Args:
        source: what named the groom: a bundled style or a file.
        groom: that is draped.
        head: the head mesh of a strand file.

    Raises:
        InputError: neither a number nor one of these words, or a groom without a source.
    """
    if strands is None or strands == GUIDES:
        return None
    if strands == ORIGINAL:
        return original_strands(load_source(source, body, head), groom, body)
    if not strands.isdecimal() or len(strands) > 18:
        raise InputError(OPTION, f"a number of strands, {ORIGINAL} or {GUIDES}", repr(strands))
    return interpolation_of(groom, body, int(strands))


def clip_of_pictures(
    clip: ExportClip, strands: str | None, groom: Groom | None, body: BodyModel, in_video: bool = False
) -> ExportClip:
    """What pictures or videos show. Where nobody asked for certain strands and the draped ones are fewer than shown
    there, it is strands between them, and a line is printed about it.

    Args:
        strands: what was asked for.
        groom: that was draped, where it is known.
    """
    between = None if strands is not None or groom is None else shown_between(groom, body, in_video)
    if between is None:
        return clip
    draped, what = clip.sequence.strands.shape[1], "videos" if in_video else "pictures"
    lines = [
        f"{what} show {len(between)} strands between the {draped} draped ones "
        f"({OPTION} {GUIDES}: the draped ones alone; {OPTION} N: another number)"
    ]
    if draped < FEW_GUIDES:
        lines.append(
            f"warning: {draped} guides are few: strands between them may look like slabs. Export {FEW_GUIDES} or more "
            f"from the program that made them, or draw them alone ({OPTION} {GUIDES})"
        )
    for line in lines:
        console.print(line)
    return replace(clip, interpolation=between)


def shown_in(
    paths: Iterable[Path], clip: ExportClip, pictured: Callable[[bool], ExportClip]
) -> Iterator[tuple[Path, ExportClip]]:
    """Each path with the clip that it shows.

    Args:
        pictured: what pictures show, or videos where its argument is true; called once for each of the two, when a path
            needs it.
    """
    pictured = cache(pictured)
    for path in paths:
        suffix = path.suffix.lower()
        yield path, pictured(suffix == VIDEO) if suffix in PICTURES else clip


def source_of_drape(draped: Groom, path: Path | None, body: BodyModel, head: Path | None) -> Groom:
    """The groom of a file, with which a drape was made.

    Args:
        draped: as the drape has it.
        path, head: the file, and the head mesh that it was draped with.

    Raises:
        InputError: no file, or one of another groom.
    """
    if path is None:
        raise InputError("--groom", f"the groom file that was draped, with {OPTION} {ORIGINAL}", "none")
    groom = load_groom(path, body, head)
    rest, own = draped.rest_strands, groom.rest_strands
    if rest.shape != own.shape:
        raise InputError(path, f"the groom of the drape, {len(rest)} strands", f"{len(own)} strands that are draped")
    apart = float((rest[:, 0] - own[:, 0]).norm(dim=-1).max())
    longer = float((draped.strand_lengths - groom.strand_lengths).abs().max())
    if max(apart, longer) > SAME_STRAND:
        raise InputError(path, "the groom of the drape", f"strands that are {1e3 * max(apart, longer):.1f} mm off")
    return groom
