"""Goals that draw strands of a clip back to their place around the head.

Hair that falls over a face when a head bows has, when the head has risen again, the same energy there as beside the
face (`bob`, CMU 13_26, frame 430: 0.210 and 0.215 below zero in units of m g L), so that no solver brings it back. Only
how hair lies around the head is taken for the style: on shoulders it stays where the last frames have left it.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RestoringGoals:
    """How strongly strands are drawn to the directions in which they were posed, and which.

    Attributes:
        weight: of the goals of a strand together [m g L].
        energy: by which a strand's own energy where it was posed may exceed that where it is [m g L]. Its goals have no
            weight at that difference and their whole weight at none, so that gravity keeps hair of a head that bows.
        displacement: of a vertex from where it was posed up to which a strand is in its place [m]. At twice that, its
            goals have their whole weight.
        radius: of the sphere around the mean of the roots in which edges are drawn, in units of the farthest root's
            distance.
    """

    weight: float = 8.0
    energy: float = 0.02
    displacement: float = 0.02
    radius: float = 1.3

    def __post_init__(self) -> None:
        """Raises:
        ValueError: an energy or a displacement that is not above 0, or a weight or a radius below it.
        """
        if not (self.energy > 0 and self.displacement > 0 and self.weight >= 0 and self.radius >= 0):
            raise ValueError(f"expected energy and displacement above 0, weight and radius of 0 and more, found {self}")

    def displaced(self, positions: np.ndarray, posed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far strands have left their place around the head, 0 to 1 [strand], and which edges are in it by design.

        Args:
            positions, posed: vertices as they are and as they were posed [m], [strand vertex 3].
        """
        distance = np.linalg.norm(posed - posed[:, 0].mean(axis=0), axis=-1)
        on_head = distance < self.radius * distance[:, 0].max()
        moved = (np.linalg.norm(positions - posed, axis=-1) * on_head).max(axis=1)
        return np.clip(moved / self.displacement - 1, 0, 1), on_head[:, 1:]

    def weights(self, displaced: np.ndarray, on_head: np.ndarray, excess: np.ndarray) -> np.ndarray:
        """Weight of the goal of every edge [m g L], [strand edge].

        Args:
            displaced, on_head: of the strands, see `displaced`.
            excess: own energy where they were posed, above that where they are [m g L], [strand].
        """
        share = displaced * np.clip(1 - excess / self.energy, 0, 1)
        return self.weight / on_head.shape[1] * share[:, None] * on_head
