"""Resistance of every edge to a change of its length, Eq. 7."""

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.geometry.polyline import edges
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Positions, RestLengths, Scalar, Tensor


def energy_stretch(positions: Positions, rest_length: RestLengths, k_stretch: Scalar) -> Energy:
    """Eq. 7: half k_stretch [N/m] times the squared change of length [m] of every edge [J]."""
    length = edges(positions).norm(dim=-1)
    return 0.5 * k_stretch * (length - rest_length).square().sum(dim=(-2, -1))


def length_errors(positions: Positions, rest_length: RestLengths) -> Float[Tensor, "b s e"]:
    """Relative change of length of every edge, abs(l - l_rest) / l_rest, dimensionless."""
    return (edges(positions).norm(dim=-1) - rest_length).abs() / rest_length


class Stretch(EnergyTerm):
    """Eq. 7."""

    name = "stretch"
    equation = "Eq. 7"
    metric_unit = "%"

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return energy_stretch(hair.positions, hair.rest.rest_length, hair.material.k_stretch)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s e"]:
        return 100 * length_errors(hair.positions, hair.rest.rest_length)
