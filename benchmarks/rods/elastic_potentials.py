"""The elastic models as functions of positions and, for the full rod, quaternions that are free of their edges."""

from collections.abc import Callable
from typing import NamedTuple

from quaffure.config import HairMaterial
from quaffure.energies import RodStiffness, Springs, SpringStiffness, energy_stretch, energy_stretch_shear
from quaffure.energies.cosserat import CosseratRod
from quaffure.geometry import directors
from quaffure.types import Energy, Float, Positions, RestLengths, Tensor

Unknowns = Float[Tensor, "b s e u"]


class ElasticPotential(NamedTuple):
    """Elastic energy of strands whose posed shape is unstrained.

    Attributes:
        energy: of positions [m] and unknowns [J]; of one sample it serves a batch.
        unknowns: of the posed edges; the last axis is empty for models of positions alone.
    """

    energy: Callable[[Positions, Unknowns], Energy]
    unknowns: Unknowns


ElasticModel = Callable[[Positions, RestLengths], ElasticPotential]
"""Makes the potential of posed strands [m]."""


def modified_cosserat(material: HairMaterial | None = None) -> ElasticModel:
    """Eqs. 6-8."""
    k = material or HairMaterial()

    def on(posed: Positions, rest_length: RestLengths) -> ElasticPotential:
        def energy(positions: Positions, unknowns: Unknowns) -> Energy:
            director = directors(posed).expand(len(positions), -1, -1, -1)
            bending = energy_stretch_shear(positions, director, rest_length, k.k_cosserat)
            return bending + energy_stretch(positions, rest_length, k.k_stretch)

        return ElasticPotential(energy, _none(posed))

    return on


def cosserat(stiffness: RodStiffness | None = None) -> ElasticModel:
    """Eqs. 2-5. The unknowns are the quaternions of the edges (`wxyz`)."""

    def on(posed: Positions, rest_length: RestLengths) -> ElasticPotential:
        rod = CosseratRod(stiffness or RodStiffness(), posed, rest_length)
        return ElasticPotential(rod.energy, rod.frames)

    return on


def mass_spring(stiffness: SpringStiffness | None = None) -> ElasticModel:
    """Springs between vertices."""

    def on(posed: Positions, rest_length: RestLengths) -> ElasticPotential:
        springs = Springs(stiffness or SpringStiffness(), posed)
        return ElasticPotential(lambda positions, unknowns: springs.energy(positions), _none(posed))

    return on


MODELS: dict[str, ElasticModel] = {
    "modified_cosserat": modified_cosserat(),
    "cosserat": cosserat(),
    "mass_spring": mass_spring(),
}


def _none(posed: Positions) -> Unknowns:
    return posed.new_zeros(*posed.shape[:2], posed.shape[2] - 1, 0)
