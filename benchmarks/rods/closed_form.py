"""Edges at the minimum of the energies that act on edges alone, in closed form: the oracle of every solver."""

import torch

from quaffure.energies import equilibrium_vectors
from quaffure.types import EdgeVectors, Float, RestLengths, Tensor


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
