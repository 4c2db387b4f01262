"""The minimum of the energies that act on edges alone: exact where nothing touches.

Gravity pulls on every edge with the weight M g of what hangs beyond it, so the minimum splits edge by edge. It is the
oracle of every solver and the start of the network's drape.
"""

from quaffure.energies.gravity import GRAVITY
from quaffure.types import EdgeVectors, Float, RestLengths, Scalar, Tensor


def equilibrium_vectors(
    director: EdgeVectors,
    rest_length: RestLengths,
    mass_beyond: Float[Tensor, "s e"],
    k_cosserat: Scalar,
    acceleration: tuple[float, float, float] = GRAVITY,
) -> EdgeVectors:
    """d3 + (l M / k) g: along the edges at the minimum of Eqs. 6 and 9, dimensionless.

    Multiplied by the rest length they are those edges (Eqs. 6 and 9 alone, stretch allowed). Normalized and multiplied
    by it they are the edges at the minimum when no edge may change its length.
    """
    pull = rest_length * mass_beyond / k_cosserat
    return director + pull[..., None] * director.new_tensor(acceleration)
