"""`quaffure grooms`: the bundled hairstyles."""

from dataclasses import dataclass
from pathlib import Path

from quaffure.apps.cli.console import console, print_json, print_rows
from quaffure.apps.output_path import check_output
from quaffure.body.body_model import load_body
from quaffure.hair.clearance import rest_surface
from quaffure.procedural.generator import LICENCE, make_groom
from quaffure.procedural.hair_style import HELD_OUT, STYLES
from quaffure.procedural.style_sizes import StyleSize, style_sizes


@dataclass(frozen=True)
class GroomsCommand:
    """The bundled grooms."""

    json: bool = False
    """Print JSON instead of a table."""
    out: Path | None = None
    """Draw them all to this picture (.png), each from three sides."""

    def run(self) -> None:
        # Growing takes a while: what cannot be written is refused before.
        if self.out is not None:
            check_output(self.out, ".png")
            _draw(self.out)
        rows = [_row(name, size) for name, size in style_sizes().items()]
        print_json(rows) if self.json else print_rows(rows, "bundled grooms")


def _draw(path: Path) -> None:
    from quaffure.apps.render.contact_sheet import write_contact_sheet

    body = load_body()
    with console.status("growing the grooms"):
        surface = rest_surface(body)
        grooms = [make_groom(name, body, surface=surface) for name in STYLES]
    notes = {
        groom.name: f"{groom.strand_lengths.mean():.2f} m" + (", held out" if groom.name in HELD_OUT else "")
        for groom in grooms
    }
    with console.status("drawing the grooms") as status:
        write_contact_sheet(
            path, grooms, body, notes, lambda done: status.update(f"drawing the grooms: {done} of {len(grooms)}")
        )


def _row(name: str, size: StyleSize) -> dict[str, object]:
    return {
        "name": name,
        "style": name.replace("_", " "),
        "strands": size.strands,
        "length_m": size.length_m,
        "licence": LICENCE,
        "held_out": name in HELD_OUT,
    }
