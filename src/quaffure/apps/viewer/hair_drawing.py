"""Strands that the live page draws for a drape, and their colours."""

import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from quaffure.apps.viewer.catalogue import Catalogue
from quaffure.apps.viewer.hair_colours import hair_colours
from quaffure.apps.viewer.view_state import Drape
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import GuideInterpolation

ALL_STRANDS = 10_000
"""A full head of hair on the page."""
MOST_MILLISECONDS = 100.0
"""For the points and colours of one drape, so that hair still moves as a slider does."""
TRIALS = 3


class Display(NamedTuple):
    """How drapes are drawn.

    Attributes:
        strand_count: None for as many as the machine draws in time, 0 for the guides.
        mark_inside: whether vertices inside the body are marked.
    """

    strand_count: int | None = None
    mark_inside: bool = False


class HairDrawing:
    """Computes what is drawn of a drape.

    Args:
        most_milliseconds: that all strands may take by `Display.strand_count` None; guides are drawn where they take
            longer, or where none can be interpolated.

    Attributes:
        display: how the next drape is drawn.
    """

    def __init__(self, catalogue: Catalogue, display: Display, most_milliseconds: float = MOST_MILLISECONDS) -> None:
        self.display = display
        self._catalogue, self._most_milliseconds = catalogue, most_milliseconds
        self._milliseconds: float | None = None
        self._without_strands: Groom | None = None

    def interpolation(self, drape: Drape) -> GuideInterpolation | None:
        """The interpolation of the strands to draw; None where the guides are drawn."""
        count = self.display.strand_count
        if count is not None:
            return self._catalogue.interpolation(drape.state.groom, count) if count else None
        return self._automatic(drape)

    def strands(self, drape: Drape) -> tuple[Float[np.ndarray, "m n 3"], UInt8[np.ndarray, "m n 3"]]:
        """Strands to draw [m, world], and linear RGB of their vertices."""
        strands = _strands(drape, self.interpolation(drape))
        return strands, hair_colours(strands, drape.inside(strands) if self.display.mark_inside else None)

    def note(self, drape: Drape) -> str:
        """What is drawn, for the status of the page."""
        interpolation = self.interpolation(drape)
        if interpolation is not None:
            return f"{len(interpolation):,} strands drawn"
        if self.display.strand_count is not None:
            return "guides drawn"
        if drape.state.groom is self._without_strands:
            return "guides drawn, too few for strands between them"
        return f"guides drawn: {ALL_STRANDS:,} strands would take {self._milliseconds:.0f} ms here"

    def _automatic(self, drape: Drape) -> GuideInterpolation | None:
        if drape.state.groom is self._without_strands:
            return None
        try:
            interpolation = self._catalogue.interpolation(drape.state.groom, ALL_STRANDS)
        except InputError:
            self._without_strands = drape.state.groom
            return None
        if self._milliseconds is None:
            self._milliseconds = self._measure(drape, interpolation)
        return interpolation if self._milliseconds <= self._most_milliseconds else None

    def _measure(self, drape: Drape, interpolation: GuideInterpolation) -> float:
        """Time of all strands, without that of the first call, which compiles kernels [ms]."""
        times = []
        for _ in range(1 + TRIALS):
            start = time.perf_counter()
            hair_colours(_strands(drape, interpolation))
            times.append(1000.0 * (time.perf_counter() - start))
        return min(times[1:])


def _strands(drape: Drape, interpolation: GuideInterpolation | None) -> Float[np.ndarray, "m n 3"]:
    if interpolation is None:
        return drape.strands
    return interpolation.strands(drape.strands, drape.body_vertices)
