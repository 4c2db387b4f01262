"""Goals that draw strands of a clip back to their place around the head.

Hair that falls over a face when a head bows has, when the head has risen again, the same energy there as beside the
face (`bob`, CMU 13_26, frame 430: 0.210 and 0.215 below zero in units of m g L), so that no solver brings it back. Only
how hair lies around the head is taken for the style: on shoulders it stays where the last frames have left it.
"""

from dataclasses import dataclass

import numpy as np

from quaffure.solvers.strand_kernels import Evaluation


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

    def weights(self, now: Evaluation, posed: Evaluation, m_g_l: np.ndarray) -> np.ndarray:
        """Weight of the goal of every edge [J], [strand edge].

        Args:
            now, posed: the hair as it is, and in the directions in which it was posed.
            m_g_l: unit of energy of every strand [J].
        """
        centre = posed.positions[:, 0].mean(axis=0)
        distance = np.linalg.norm(posed.positions - centre, axis=-1)
        on_head = distance < self.radius * distance[:, 0].max()
        displaced = (np.linalg.norm(now.positions - posed.positions, axis=-1) * on_head).max(axis=1)
        excess = (posed.energy[:, 0] - now.energy[:, 0]) / m_g_l
        share = np.clip(1 - excess / self.energy, 0, 1) * np.clip(displaced / self.displacement - 1, 0, 1)
        edges = on_head.shape[1] - 1
        return ((share * self.weight / edges * m_g_l)[:, None] * on_head[:, 1:]).astype(np.float32)
