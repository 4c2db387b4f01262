"""What the energies read of a groom at rest."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import torch

from quaffure.config import HairMaterial
from quaffure.geometry.polyline import integrate_directions_reference
from quaffure.types import Bool, EdgeVectors, Float, Positions, RestLengths, Tensor

if TYPE_CHECKING:
    from quaffure.energies.rod import RodRest


HELD_DENSITY = 1e9
"""Density at rest of held vertices: above all that Eq. 11 could find [kg/m^3]."""


@dataclass(frozen=True)
class RestState:
    """Rest quantities of a groom, made once and shared by every pose.

    Attributes:
        rest_strands: vertices of the rest groom [m].
        smoothing_length: h of the density [m].
        rest_length: of every edge (l_rest) [m].
        mass: lumped at every vertex (m) [kg]: half of each adjacent edge, the root included.
        collision_margin: distance D that every vertex keeps from the body [m]; zero at the root.
        stiffness_scale: multiple of a human hair's stiffness that the groom asks for; 1 without.
        goal_weight: weight with which the groom asks for edges to be held [J]; none is without.
        held: vertices at the end of a held edge, which may come as close to each other as they like.
    """

    rest_strands: Float[Tensor, "s n 3"]
    smoothing_length: float
    rest_length: RestLengths
    mass: Float[Tensor, "s n"]
    collision_margin: Float[Tensor, "s n"]
    stiffness_scale: Float[Tensor, "s e"] | None = None
    goal_weight: Float[Tensor, "s e"] | None = None
    held: Bool[Tensor, "s n"] | None = None

    @cached_property
    def rest_density(self) -> Float[Tensor, "s n"]:
        """Density of hair at every vertex of the rest groom (rho_rest) [kg/m^3]."""
        from quaffure.energies.self_collision import densities  # whose energy term reads this class

        found = densities(self.rest_strands[None], self.mass, self.smoothing_length)[0]
        return found if self.held is None else torch.where(self.held.to(found.device), HELD_DENSITY, found)

    @cached_property
    def stress_free_rod(self) -> "RodRest":
        """The rod that the groom at rest is without any load."""
        from quaffure.energies.rod import stress_free_rest  # whose energy term reads this class

        scale, goal = (None if part is None else part.double() for part in (self.stiffness_scale, self.goal_weight))
        return stress_free_rest(self.rest_strands.double(), scale, goal_weight=goal)

    @property
    def mass_beyond(self) -> Float[Tensor, "s e"]:
        """Mass that hangs on every edge: all vertices from its far end to the tip (M) [kg]."""
        return self.mass[:, 1:].flip(1).cumsum(1).flip(1)

    @property
    def strand_length(self) -> Float[Tensor, " s"]:
        return self.rest_length.sum(dim=1)

    def posed_from_root(self, director: EdgeVectors) -> Positions:
        """Posed strands with their roots at the origin [m], where float32 keeps more digits than at a head's height."""
        root = director.new_zeros(*director.shape[:2], 3)
        return integrate_directions_reference(root, director, self.rest_length.to(director))


def rest_state(rest_strands: Float[Tensor, "s n 3"], material: HairMaterial) -> RestState:
    """Rest quantities of a groom of strands [m] made of `material`."""
    rest_length = rest_strands.diff(dim=1).norm(dim=-1)
    half = 0.5 * material.linear_density * rest_length
    mass = torch.nn.functional.pad(half, (0, 1)) + torch.nn.functional.pad(half, (1, 0))
    from_root = torch.nn.functional.pad(rest_length.cumsum(dim=1), (1, 0))
    margin = (material.collision_ramp * from_root).clamp(max=material.collision_margin)
    return RestState(rest_strands, material.smoothing_length, rest_length, mass, margin)
