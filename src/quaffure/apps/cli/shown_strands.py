"""Which strands are shown with a drape: more between the draped ones, or those of the groom's source."""

from pathlib import Path

from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import GuideInterpolation, interpolation_of
from quaffure.hair.source_strands import original_strands
from quaffure.io.load_groom import load_groom, load_source

ORIGINAL = "original"
OPTION = "--strands"
SAME_STRAND = 1e-3
"""Largest distance of roots, and difference of lengths, of one strand of a drape and of its groom [m]."""


def strands_between(
    strands: str, source: str, groom: Groom, body: BodyModel, head: Path | None = None
) -> GuideInterpolation:
    """Strands of a drape by a number of them, or `ORIGINAL`.

    Args:
        source: what named the groom: a bundled style or a file.
        groom: that is draped.
        head: the head mesh of a strand file.

    Raises:
        InputError: neither a number nor `ORIGINAL`, or a groom without a source.
    """
    if strands == ORIGINAL:
        return original_strands(load_source(source, body, head), groom, body)
    if not strands.isdecimal() or len(strands) > 18:
        raise InputError(OPTION, f"a number of strands, or {ORIGINAL}", repr(strands))
    return interpolation_of(groom, body, int(strands))


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
