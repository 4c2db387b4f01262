"""Deep contact must not drown everything else while an optimizer starts.

The cubic of Eq. 10 pushes a vertex 5 cm inside the body with 300 times the force of one on the skin. Minimizers that
scale by remembered gradients then stand still long after it is out. Saturating the force changes no minimum where
vertices rest near the skin, and keeps every direction of descent.
"""

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.rest_state import RestState
from quaffure.types import Positions

MAX_FORCE = 10.0
"""Largest force on a vertex, in weights of its whole strand."""


def clip_gradients(positions: Positions, rest: RestState, joules: float) -> Positions:
    """The same positions; on the way back, each vertex's gradient is scaled down to at most `MAX_FORCE`.

    Args:
        joules: what one unit of the loss means [J], so that gradients become forces [N].
    """
    limit = MAX_FORCE * STANDARD_GRAVITY * rest.mass.sum(dim=1)[:, None, None] / joules
    through = positions.view_as(positions)

    def at_most(gradient: Positions) -> Positions:
        return gradient * (limit / gradient.norm(dim=-1, keepdim=True).clamp(min=1e-30)).clamp(max=1.0)

    if through.requires_grad:
        through.register_hook(at_most)
    return through
