"""Hair against hair as density of smoothed particles, Eqs. 11-13."""

import torch

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.energies.smoothing_kernel import kernel_volume, smoothing_kernel
from quaffure.geometry.cell_list import fixed_radius_pairs
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Int, Positions, Scalar, Tensor


def density(
    positions: Float[Tensor, "p 3"], mass: Float[Tensor, " p"], pairs: Int[Tensor, "2 m"], smoothing_length: float
) -> Float[Tensor, " p"]:
    """Eq. 12 over the normalized kernel [kg/m^3], of one sample; a vertex counts itself.

    Args:
        positions: all vertices of the groom [m].
        mass: their masses [kg].
        pairs: every unordered pair closer than 2h, from `fixed_radius_pairs`.
        smoothing_length: h [m].
    """
    first, second = pairs
    # sqrt has no gradient at 0: two vertices at the same position push each other in no direction.
    squared = (positions[first] - positions[second]).square().sum(-1)
    weight = smoothing_kernel(squared.clamp(min=1e-16).sqrt(), smoothing_length)
    own = mass * 4
    total = own.index_add(0, first, mass[second] * weight).index_add(0, second, mass[first] * weight)
    return total / kernel_volume(smoothing_length)


def densities(positions: Positions, mass: Float[Tensor, "s n"], smoothing_length: float) -> Float[Tensor, "b s n"]:
    """Density at every vertex of every sample [kg/m^3], with the neighbours searched anew."""
    return torch.stack(
        [
            density(
                sample.flatten(0, 1),
                mass.flatten(),
                fixed_radius_pairs(sample.flatten(0, 1), 2 * smoothing_length),
                smoothing_length,
            ).reshape(mass.shape)
            for sample in positions
        ]
    )


def energy_self_collision(
    density: Float[Tensor, "b s n"], rest_density: Float[Tensor, "s n"], k_self_collision: Scalar
) -> Energy:
    """Eq. 11: k_sc times the cubed excess of the density over that of the rest groom at the same vertex [J]."""
    return k_self_collision * (density - rest_density).clamp(min=0).pow(3).sum(dim=(-2, -1))


def density_excesses(density: Float[Tensor, "b s n"], rest_density: Float[Tensor, "s n"]) -> Float[Tensor, "b s n"]:
    """Metric of Eq. 11: max(rho / rho_rest - 1, 0) [%]."""
    return (density / rest_density - 1).clamp(min=0) * 100


class SelfCollision(EnergyTerm):
    """Eqs. 11-13."""

    name = "self_collision"
    equation = "Eqs. 11-13"
    metric_unit = "%"

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        density = self._densities(hair)
        return energy_self_collision(density, hair.rest.rest_density, hair.material.k_self_collision)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s n"]:
        return density_excesses(self._densities(hair), hair.rest.rest_density)

    def _densities(self, hair: HairState) -> Float[Tensor, "b s n"]:
        return densities(hair.positions, hair.rest.mass, hair.material.smoothing_length)
