"""Number and length of the strands of the bundled styles, without generating them."""

import json
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True)
class StyleSize:
    """Size of a bundled style with seed 0.

    Attributes:
        strands: guides.
        length_m: mean length of a strand [m].
    """

    strands: int
    length_m: float


def style_sizes() -> dict[str, StyleSize]:
    """Sizes by name, in the order of `STYLES`; written by `scripts/measure_styles.py`."""
    text = (files("quaffure") / "assets" / "style_sizes.json").read_text(encoding="utf-8")
    return {name: StyleSize(**size) for name, size in json.loads(text).items()}
