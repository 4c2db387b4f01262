"""Which strands are shown with a drape: more between the draped ones, or those of the groom's source."""

from pathlib import Path

from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import GuideInterpolation, interpolation_of
from quaffure.hair.source_strands import original_strands
from quaffure.io.load_groom import load_source

ORIGINAL = "original"
OPTION = "--strands"


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
