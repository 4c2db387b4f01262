"""The paper's modified Cosserat model, Eq. 6: every edge keeps its direction on the posed strand.

`director` is the unit tangent d3 of the same edge of the rigidly posed groom.
"""

import torch

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.geometry.polyline import edges
from quaffure.scene import HairScene
from quaffure.types import EdgeVectors, Energy, Float, Positions, RestLengths, Scalar, Tensor


def stretch_shear_strain(positions: Positions, director: EdgeVectors, rest_length: RestLengths) -> EdgeVectors:
    """Modified stretch-shear strain (Gamma tilde, below Eq. 6) of positions [m], dimensionless."""
    return edges(positions) / rest_length[..., None] - director


def energy_stretch_shear(
    positions: Positions, director: EdgeVectors, rest_length: RestLengths, k_cosserat: Scalar
) -> Energy:
    """Eq. 6: half k_Cosserat [J] times the squared strain of every edge [J]."""
    strain = stretch_shear_strain(positions, director, rest_length)
    return 0.5 * k_cosserat * strain.square().sum(dim=(-3, -2, -1))


def orientation_errors(positions: Positions, director: EdgeVectors) -> Float[Tensor, "b s e"]:
    """Metric of Eq. 6: angle between every edge and its director [deg]."""
    edge = edges(positions)
    sine = torch.linalg.cross(edge, director).norm(dim=-1)
    return torch.rad2deg(torch.atan2(sine, (edge * director).sum(-1)))


class StretchShear(EnergyTerm):
    """Eq. 6. Edges do not depend on each other."""

    name = "stretch_shear"
    equation = "Eq. 6"
    metric_unit = "deg"

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return energy_stretch_shear(hair.positions, scene.director, hair.rest.rest_length, hair.material.k_cosserat)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s e"]:
        return orientation_errors(hair.positions, scene.director)
