"""Deep contact must not drown everything else while an optimizer starts.

The cubic of Eq. 10 pushes a vertex 5 cm inside the body with 300 times the force of one on the skin. Minimizers that
scale by remembered gradients then stand still long after it is out. Saturating the force changes no minimum where
vertices rest near the skin, and keeps every direction of descent.
"""

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.rest_state import RestState
from quaffure.types import Energy, Positions, Tensor

MAX_FORCE = 10.0
"""Largest force on a vertex, in weights of its whole strand."""


def clip_gradients(positions: Positions, rest: RestState, joules: float | Energy) -> None:
    """Scale each vertex's gradient down to at most `MAX_FORCE` where it is passed back through the positions.

    Args:
        positions: no leaf, or every call would add to what earlier ones do.
        joules: what one unit of the loss means [J], of all samples or of each, so that gradients become forces [N].
    """
    strand_weight = STANDARD_GRAVITY * rest.mass.sum(dim=1)[:, None, None]
    limit = MAX_FORCE * strand_weight / (joules[:, None, None, None] if isinstance(joules, Tensor) else joules)

    def at_most(gradient: Positions) -> Positions:
        return gradient * (limit / gradient.norm(dim=-1, keepdim=True).clamp(min=1e-30)).clamp(max=1.0)

    if positions.requires_grad:
        positions.register_hook(at_most)
