"""The objective that training and every solver share, Eq. 1 without the regularization of poses."""

import torch

from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.body_collision import energy_body_collision
from quaffure.energies.elastic import energy_stretch, energy_stretch_shear
from quaffure.energies.fused_density import fused_self_collision
from quaffure.energies.fused_strand import TERMS, strand_energy
from quaffure.energies.gravity import energy_gravity_above_root
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.energies.self_collision import densities, energy_self_collision
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.surface import Surface
from quaffure.groom.groom import Groom
from quaffure.types import EdgeVectors, Energy, Float, Positions, Tensor


class HairEnergy:
    """Energy of one groom in any batch of poses: Eqs. 6, 7, 9, 10 and 11.

    Attributes:
        rest: rest quantities of the groom.
        material: physical parameters.
    """

    def __init__(self, groom: Groom, material: HairMaterial | None = None) -> None:
        self.material = material or HairMaterial()
        self.rest: RestState = rest_state(groom.rest_strands, self.material)

    @property
    def scale(self) -> float:
        """Energy of lifting an average vertex by its strand's length, m g L [J]: the unit of `excess_energy`."""
        lifted = self.rest.mass * self.rest.strand_length[:, None]
        return STANDARD_GRAVITY * float(lifted.mean())

    def total(self, positions: Positions, director: EdgeVectors, surface: Surface) -> Energy:
        """Sum of all terms [J], differentiable in the positions [m]."""
        return self.along_strands(positions, director, surface) + self.self_collision(positions)

    def along_strands(self, positions: Positions, director: EdgeVectors, surface: Surface) -> Energy:
        """Sum of the terms that couple a strand to itself and the body: Eqs. 6, 7, 9, 10 [J].

        Compiled for float32 on the CPU, as are all the sums here; the torch twin elsewhere.
        """
        if not _compiled(positions):
            return torch.stack(list(self._reference_strand_terms(positions, director, surface).values())).sum(dim=0)
        return strand_energy(positions, director, self.rest, self.material, surface)[0]

    def self_collision(self, positions: Positions) -> Energy:
        """Eq. 11 [J]."""
        if not _compiled(positions):
            density = densities(positions, self.rest.mass, self.material.smoothing_length)
            return energy_self_collision(density, self.rest.rest_density, self.material.k_self_collision)
        return fused_self_collision(positions, self.rest, self.material)

    def terms(self, positions: Positions, director: EdgeVectors, surface: Surface) -> dict[str, Energy]:
        """Every term by name [J], without gradient."""
        with torch.no_grad():
            if not _compiled(positions):
                return self.reference_terms(positions, director, surface)
            _, along_strands = strand_energy(positions, director, self.rest, self.material, surface)
            named = dict(zip(TERMS, along_strands.unbind(1)))
            return named | {"self_collision": fused_self_collision(positions, self.rest, self.material)}

    def reference_terms(self, positions: Positions, director: EdgeVectors, surface: Surface) -> dict[str, Energy]:
        """Every term by name [J], differentiable, written out in torch: the twin of the compiled kernels."""
        density = densities(positions, self.rest.mass, self.material.smoothing_length)
        of_density = energy_self_collision(density, self.rest.rest_density, self.material.k_self_collision)
        return self._reference_strand_terms(positions, director, surface) | {"self_collision": of_density}

    def _reference_strand_terms(
        self, positions: Positions, director: EdgeVectors, surface: Surface
    ) -> dict[str, Energy]:
        rest, material = self.rest, self.material
        distance = signed_distance(positions.flatten(1, 2), surface).reshape(positions.shape[:3])
        return {
            "stretch_shear": energy_stretch_shear(positions, director, rest.rest_length, material.k_cosserat),
            "stretch": energy_stretch(positions, rest.rest_length, material.k_stretch),
            "gravity": energy_gravity_above_root(positions, rest.mass),
            "body_collision": energy_body_collision(distance, rest.collision_margin, material.k_body_collision),
        }

    @property
    def per_vertex_unit(self) -> float:
        """`scale` times the number of vertices [J]."""
        return self.rest.mass.numel() * self.scale

    def per_vertex(self, energy: Energy) -> Float[Tensor, " b"]:
        """Energy [J] in units of `scale`, per vertex: dimensionless, comparable between grooms."""
        return energy / self.per_vertex_unit


def _compiled(positions: Positions) -> bool:
    return positions.device.type == "cpu" and positions.dtype == torch.float32
