"""Writes `assets/style_sizes.json`, which `quaffure grooms` reads: `python scripts/measure_styles.py`."""

import json
from pathlib import Path

from quaffure.body import load_body
from quaffure.procedural import STYLES, make_groom

OUT = Path(__file__).parents[1] / "src" / "quaffure" / "assets" / "style_sizes.json"


def main() -> None:
    body = load_body()
    grooms = (make_groom(name, body) for name in STYLES)
    sizes = {
        groom.name: {"strands": len(groom), "length_m": round(float(groom.strand_lengths.mean()), 3)}
        for groom in grooms
    }
    OUT.write_text(json.dumps(sizes, indent=1) + "\n")


if __name__ == "__main__":
    main()
