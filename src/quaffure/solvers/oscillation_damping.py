"""Damping of single strands that move back and forth from pass to pass.

All strands move at once, each against the others where they were. In dense hair two that push each other both give
way, and push again in the next pass: played as a clip, hair at rest would tremble by millimetres.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class OscillationDamping:
    """How the damping of a strand follows the cosine between its displacements in two passes.

    Damping d makes the stiffness against the hair around 1 + d times as large, and adds `weight_share` d of what its
    weight alone would give.

    Attributes:
        reversed: cosine below which damping grows.
        steady: cosine above which it decays.
        first, growth, most: what it grows to at first, by which factor then, and to at most.
        decay: factor by which it decays.
        weight_share: of the weight of a vertex.
    """

    reversed: float = 0.0
    steady: float = 0.3
    first: float = 0.5
    growth: float = 2.0
    most: float = 64.0
    decay: float = 0.5
    weight_share: float = 0.1

    def updated(self, damping: np.ndarray, moved: np.ndarray, moved_before: np.ndarray) -> np.ndarray:
        """The damping of every strand [strand] after displacements in a pass and in the one before it
        [strand vertex 3]."""
        product = np.einsum("sva,sva->s", moved, moved_before)
        lengths = np.sqrt((moved * moved).sum(axis=(1, 2)) * (moved_before * moved_before).sum(axis=(1, 2)))
        cosine = product / np.maximum(lengths, 1e-12)
        raised = np.clip(self.growth * damping, self.first, self.most)
        kept = np.where(cosine > self.steady, self.decay * damping, damping)
        return np.where(cosine < self.reversed, raised, kept).astype(damping.dtype)
