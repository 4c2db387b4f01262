"""Contact with the body, Eq. 10."""

from quaffure.types import Energy, Float, Tensor


def energy_body_collision(
    distance: Float[Tensor, "b s n"], margin: Float[Tensor, "s n"], k_body_collision: float
) -> Energy:
    """Eq. 10: k_bc times the cubed shortfall of the distance d(x) below the margin D.

    Args:
        distance: signed distance to the body, positive outside [m].
        margin: D of every vertex [m].
        k_body_collision: k_bc [J/m^3].

    Returns:
        Energy [J]; zero, with zero gradient, where the distance is at least the margin.
    """
    return k_body_collision * (margin - distance).clamp(min=0).pow(3).sum(dim=(-2, -1))
