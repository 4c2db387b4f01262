"""Width of the strands that stand for a head of hair."""

import math

# Up to this many strands are drawn with this width [m].
WIDEST_COUNT, WIDEST_STRAND = 2400, 0.8e-3
HAIR_WIDTH = 0.7e-4  # m


def width_of(strands: int) -> float:
    """Width to draw each of this many strands with [m]: few stand for many, and are wider than a hair of 0.07 mm."""
    return max(min(WIDEST_STRAND, WIDEST_STRAND * math.sqrt(WIDEST_COUNT / strands)), HAIR_WIDTH)
