"""What is printed about a groom file that was fitted to our head."""

from pathlib import Path

from quaffure.apps.cli.console import console
from quaffure.body.body_model import BodyModel
from quaffure.config import TEXTURE_SIZE
from quaffure.hair.groom import Groom
from quaffure.hair.registration_report import RegistrationReport
from quaffure.io.load_groom import load_groom


def loaded_groom(text: str, body: BodyModel, head: Path | None) -> Groom:
    """`load_groom`, printing the report where a strand file was fitted to our head."""
    console.print(f"reading the groom {text}")
    reports: list[RegistrationReport] = []
    groom = load_groom(text, body, head, on_report=reports.append)
    for report in reports:
        print_report(report)
        print_shared_texels(report.kept, len(groom))
    return groom


def print_report(report: RegistrationReport) -> None:
    """What was guessed, which strands are used and why others are not, and how well they fit."""
    console.print(str(report))


def print_shared_texels(kept: int, draped: int) -> None:
    """Which strands are draped, where not all are.

    Args:
        kept: strands on the scalp.
        draped: of those, at most one in each texel.
    """
    if draped < kept:
        console.print(
            f"draped: {draped} of these {kept}, one in each cell of a {TEXTURE_SIZE} x {TEXTURE_SIZE} grid over the "
            "scalp; quaffure drape --strands original shows all of them",
        )
