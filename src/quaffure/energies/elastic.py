"""Elastic energy of a strand: the paper's modified Cosserat model, Eqs. 6-8.

Each function returns joules per sample. Positions are in metres; `director` is the unit tangent d3 of the same edge of
the rigidly posed groom.
"""

import torch

from quaffure.geometry.polyline import edges
from quaffure.types import EdgeVectors, Energy, Float, Positions, RestLengths, Tensor


def stretch_shear_strain(positions: Positions, director: EdgeVectors, rest_length: RestLengths) -> EdgeVectors:
    """Modified stretch-shear strain (Gamma tilde, below Eq. 6), dimensionless."""
    return edges(positions) / rest_length[..., None] - director


def energy_stretch_shear(
    positions: Positions, director: EdgeVectors, rest_length: RestLengths, k_cosserat: float
) -> Energy:
    """Eq. 6: half k_Cosserat times the squared strain of every edge; `k_cosserat` [J]."""
    strain = stretch_shear_strain(positions, director, rest_length)
    return 0.5 * k_cosserat * strain.square().sum(dim=(-3, -2, -1))


def energy_stretch(positions: Positions, rest_length: RestLengths, k_stretch: float) -> Energy:
    """Eq. 7: Hookean resistance of every edge to a change of its length; `k_stretch` [N/m]."""
    length = edges(positions).norm(dim=-1)
    return 0.5 * k_stretch * (length - rest_length).square().sum(dim=(-2, -1))


def length_errors(positions: Positions, rest_length: RestLengths) -> Float[Tensor, "b s e"]:
    """Gauge of Eq. 7: relative change of length of every edge, abs(l - l_rest) / l_rest."""
    return (edges(positions).norm(dim=-1) - rest_length).abs() / rest_length


def orientation_errors(positions: Positions, director: EdgeVectors) -> Float[Tensor, "b s e"]:
    """Gauge of Eq. 6: angle between every edge and its director [deg]."""
    edge = edges(positions)
    sine = torch.linalg.cross(edge, director).norm(dim=-1)
    return torch.rad2deg(torch.atan2(sine, (edge * director).sum(-1)))
