"""`quaffure grooms`: the bundled hairstyles."""

from dataclasses import dataclass

from quaffure.body.body_model import load_body
from quaffure.cli.console import console, print_json, print_rows
from quaffure.groom.hair_style import STYLES
from quaffure.groom.procedural import make_groom


@dataclass(frozen=True)
class GroomsCommand:
    """The bundled grooms."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        body = load_body()
        rows: list[dict[str, object]] = []
        with console.status("growing the grooms"):
            for name in STYLES:
                groom = make_groom(name, body)
                rows.append(
                    {
                        "name": name,
                        "style": name.replace("_", " "),
                        "strands": len(groom),
                        "length_m": round(float(groom.strand_lengths.mean()), 3),
                        "licence": groom.licence,
                        "held_out": False,
                    }
                )
        print_json(rows) if self.json else print_rows(rows, "bundled grooms")
