"""The minimum of the energies that act on edges alone: exact where nothing touches.

Gravity pulls on every edge with the weight M g of what hangs beyond it, so the minimum splits edge by edge. It is the
oracle of every solver and the start of the network's drape.
"""

import torch

from quaffure.energies.gravity import GRAVITY
from quaffure.types import EdgeVectors, Float, RestLengths, Tensor


def equilibrium_vectors(
    director: EdgeVectors, rest_length: RestLengths, mass_beyond: Float[Tensor, "s e"], k_cosserat: float
) -> EdgeVectors:
    """d3 + (l M / k) g: along the edges at the minimum of Eqs. 6 and 9, dimensionless.

    Multiplied by the rest length they are those edges (Eqs. 6 and 9 alone, stretch allowed). Normalized and multiplied
    by it they are the edges at the minimum when no edge may change its length.
    """
    pull = rest_length * mass_beyond / k_cosserat
    return director + pull[..., None] * director.new_tensor(GRAVITY)


def equilibrium_edges(
    director: EdgeVectors,
    rest_length: RestLengths,
    mass_beyond: Float[Tensor, "s e"],
    k_cosserat: float,
    k_stretch: float,
) -> EdgeVectors:
    """Edges [m] at the minimum of Eqs. 6, 7 and 9.

    The edge lies along p = d3 + (l M / k) g, since Eq. 7 only adds a force along it; its length r solves
    (k / l^2) r + k_s (r - l) = (k / l) |p|, the derivative of the three terms along p.
    """
    vectors = equilibrium_vectors(director, rest_length, mass_beyond, k_cosserat)
    pull = vectors.norm(dim=-1)
    bending = k_cosserat / rest_length
    length = (bending * pull + k_stretch * rest_length) / (bending / rest_length + k_stretch)
    return length[..., None] * torch.nn.functional.normalize(vectors, dim=-1)
