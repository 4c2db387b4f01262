"""Secant step for strands that swing: back in one pass over what they did in the pass before.

All strands move at once, each against the others where they were, so that neighbours that give way to each other go too
far, and come back in the next pass. Their rest is between: Anderson's acceleration [Anderson 1965] of depth one, strand
by strand, and nothing for strands that go on in their direction, where it would extrapolate.
"""

import numpy as np
from jaxtyping import Float

LEAST_SHARE = 0.2
"""A strand takes at least this share of its step."""


def secant_shares(step: Float[np.ndarray, "s e 3"], before: Float[np.ndarray, "s e 3"]) -> Float[np.ndarray, " s"]:
    """Share of its step that every strand takes: up to where the secant of this step and that before it is zero."""
    turned = step - before
    squared = np.maximum(np.einsum("sea,sea->s", turned, turned), np.finfo(step.dtype).tiny)
    share = 1 - np.einsum("sea,sea->s", step, turned) / squared
    swings = np.einsum("sea,sea->s", step, before) < 0
    return np.where(swings, np.maximum(share, LEAST_SHARE), 1).astype(step.dtype)
