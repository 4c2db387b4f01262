"""Secant step for strands that swing: back in one pass over what they did in the pass before.

All strands move at once, each against the others where they were, so that neighbours that give way to each other go too
far, and come back in the next pass. Their rest is between: Anderson's acceleration [Anderson 1965] of depth one, strand
by strand, and nothing for strands that go on in their direction, where it would extrapolate. A pass that was undone
counts as the others: without it the energy ends higher.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

FARTHEST_BACK = 0.5
"""A strand goes back by at most this share of the way between where two passes ended."""


class Pass(NamedTuple):
    """What a pass did.

    Attributes:
        reached: unit directions where it ended [strand edge 3].
        change: from where it began.
        number: of passes before it since the strands began to settle.
    """

    reached: Float[np.ndarray, "s e 3"]
    change: Float[np.ndarray, "s e 3"]
    number: int


def between_swings(last: Pass, before: Pass) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k e 3"]]:
    """The strands that swing, and unit directions for them between where the two passes ended."""
    product = np.einsum("sea,sea->s", last.change, before.change)
    swinging = np.flatnonzero(product < 0)
    change = last.change[swinging]
    turned = change - before.change[swinging]
    share = np.einsum("sea,sea->s", change, turned) / np.einsum("sea,sea->s", turned, turned)
    reached = last.reached[swinging]
    back = np.minimum(share, FARTHEST_BACK)[:, None, None] * (reached - before.reached[swinging])
    between = reached - back
    return swinging, between / np.linalg.norm(between, axis=-1, keepdims=True)
