"""The objective that training and every solver share, Eq. 1 without the regularization of poses."""

from dataclasses import replace
from weakref import ref

import torch

from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.body_collision import energy_body_collision
from quaffure.energies.elastic import energy_stretch, energy_stretch_shear
from quaffure.energies.elastic_model import ElasticState, ModifiedCosserat, Unknowns, elastic_model
from quaffure.energies.fused_density import fused_self_collision
from quaffure.energies.fused_strand import TERMS, strand_energy
from quaffure.energies.gravity import energy_gravity_above_root
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.energies.self_collision import densities, energy_self_collision
from quaffure.geometry.polyline import integrate_directions_reference
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.surface import Surface
from quaffure.hair.groom import Groom
from quaffure.types import EdgeVectors, Energy, Float, Positions, Tensor


class HairEnergy:
    """Energy of one groom in any batch of poses: an elastic model (Eqs. 6 and 7 by default), Eqs. 9, 10 and 11.

    Attributes:
        rest: rest quantities of the groom.
        material: physical parameters.
        elastic: the elastic model. `cosserat` and `mass_spring` have stiffnesses of their own and take the place of
            Eqs. 6 and 7.

    Raises:
        InputError: no elastic model of that name.
    """

    def __init__(
        self, groom: Groom, material: HairMaterial | None = None, elastic: str = ModifiedCosserat.name
    ) -> None:
        self.material = material or HairMaterial()
        self.rest: RestState = rest_state(groom.rest_strands, self.material)
        self.elastic = elastic_model(elastic)
        self._is_modified = elastic == ModifiedCosserat.name
        self._strand_material = self.material
        if not self._is_modified:
            self._strand_material = replace(self.material, k_cosserat=0.0, k_stretch=0.0)
        self._elastic_state: tuple[ref[EdgeVectors], ElasticState] | None = None

    @property
    def scale(self) -> float:
        """Energy of lifting an average vertex by its strand's length, m g L [J]: the unit of `excess_energy`."""
        lifted = self.rest.mass * self.rest.strand_length[:, None]
        return STANDARD_GRAVITY * float(lifted.mean())

    def no_turns(self, director: EdgeVectors) -> Unknowns:
        """`turns` of `following` that change nothing; their last axis is empty for models of positions alone."""
        return director[..., :0] if self._is_modified else self._state(director).no_turns

    def following(self, positions: Positions, director: EdgeVectors, turns: Unknowns) -> Unknowns:
        """The elastic model's unknowns, carried along by the edges and changed by `turns` (`ElasticState`)."""
        return turns if self._is_modified else self._state(director).following(positions, turns)

    def carried(self, positions: Positions, director: EdgeVectors) -> Unknowns:
        """The elastic model's unknowns as the edges alone carry them along: without a turn about any of them."""
        return self.following(positions, director, self.no_turns(director))

    def total(
        self, positions: Positions, director: EdgeVectors, surface: Surface, unknowns: Unknowns | None = None
    ) -> Energy:
        """Sum of all terms [J], differentiable in the positions [m] and the unknowns.

        Raises:
            ValueError: the elastic model has unknowns and none are given.
        """
        return self.along_strands(positions, director, surface, unknowns) + self.self_collision(positions)

    def along_strands(
        self, positions: Positions, director: EdgeVectors, surface: Surface, unknowns: Unknowns | None = None
    ) -> Energy:
        """Sum of the terms that couple a strand to itself and the body: the elastic model, Eqs. 9 and 10 [J].

        Compiled for float32 on the CPU, as are all the sums here; the torch twin elsewhere.
        """
        if _compiled(positions):
            own = strand_energy(positions, director, self.rest, self._strand_material, surface)[0]
        else:
            own = torch.stack(list(self._reference_strand_terms(positions, director, surface).values())).sum(dim=0)
        return own if self._is_modified else own + self._elastic_energy(positions, director, unknowns)

    def self_collision(self, positions: Positions) -> Energy:
        """Eq. 11 [J]."""
        if not _compiled(positions):
            density = densities(positions, self.rest.mass, self.material.smoothing_length)
            return energy_self_collision(density, self.rest.rest_density, self.material.k_self_collision)
        return fused_self_collision(positions, self.rest, self.material)

    def terms(
        self, positions: Positions, director: EdgeVectors, surface: Surface, unknowns: Unknowns | None = None
    ) -> dict[str, Energy]:
        """Every term by name [J], without gradient. An elastic model other than the modified one is `elastic`."""
        with torch.no_grad():
            if _compiled(positions):
                _, along_strands = strand_energy(positions, director, self.rest, self._strand_material, surface)
                named = dict(zip(TERMS, along_strands.unbind(1)))
                named["self_collision"] = fused_self_collision(positions, self.rest, self.material)
            else:
                named = self._reference_own_terms(positions, director, surface)
            return named if self._is_modified else self._with_elastic(named, positions, director, unknowns)

    def reference_terms(
        self, positions: Positions, director: EdgeVectors, surface: Surface, unknowns: Unknowns | None = None
    ) -> dict[str, Energy]:
        """Every term by name [J], differentiable, written out in torch: the twin of the compiled kernels."""
        named = self._reference_own_terms(positions, director, surface)
        return named if self._is_modified else self._with_elastic(named, positions, director, unknowns)

    def _reference_own_terms(self, positions: Positions, director: EdgeVectors, surface: Surface) -> dict[str, Energy]:
        density = densities(positions, self.rest.mass, self.material.smoothing_length)
        of_density = energy_self_collision(density, self.rest.rest_density, self.material.k_self_collision)
        return self._reference_strand_terms(positions, director, surface) | {"self_collision": of_density}

    def _reference_strand_terms(
        self, positions: Positions, director: EdgeVectors, surface: Surface
    ) -> dict[str, Energy]:
        rest, material = self.rest, self._strand_material
        distance = signed_distance(positions.flatten(1, 2), surface).reshape(positions.shape[:3])
        return {
            "stretch_shear": energy_stretch_shear(positions, director, rest.rest_length, material.k_cosserat),
            "stretch": energy_stretch(positions, rest.rest_length, material.k_stretch),
            "gravity": energy_gravity_above_root(positions, rest.mass),
            "body_collision": energy_body_collision(distance, rest.collision_margin, material.k_body_collision),
        }

    def _with_elastic(
        self, named: dict[str, Energy], positions: Positions, director: EdgeVectors, unknowns: Unknowns | None
    ) -> dict[str, Energy]:
        others = {name: term for name, term in named.items() if name not in ("stretch_shear", "stretch")}
        return {"elastic": self._elastic_energy(positions, director, unknowns)} | others

    def _elastic_energy(self, positions: Positions, director: EdgeVectors, unknowns: Unknowns | None) -> Energy:
        state = self._state(director)
        if unknowns is None:
            unknowns = state.unknowns
            if unknowns.shape[-1] > 0:
                raise ValueError(f"expected the unknowns of the elastic model {self.elastic.name}, found none")
        # Seen from the roots: elasticity is local, and float32 has more digits there.
        return state.energy(positions - positions[:, :, :1], unknowns)

    def _state(self, director: EdgeVectors) -> ElasticState:
        """The elastic model on the strands that the directors make, roots at the origin; kept as long as they are."""
        if self._elastic_state is None or self._elastic_state[0]() is not director:
            root = director.new_zeros(*director.shape[:2], 3)
            posed = integrate_directions_reference(root, director, self.rest.rest_length.to(director))
            # A training has an energy for each of its grooms: together, what they kept would fill gigabytes.
            state = self.elastic.on(posed, self.rest.rest_length.to(director))
            self._elastic_state = ref(director, self._forget), state
        return self._elastic_state[1]

    def _forget(self, director: "ref[EdgeVectors]") -> None:
        if self._elastic_state is not None and self._elastic_state[0] is director:
            self._elastic_state = None

    @property
    def per_vertex_unit(self) -> float:
        """`scale` times the number of vertices [J]."""
        return self.rest.mass.numel() * self.scale

    def per_vertex(self, energy: Energy) -> Float[Tensor, " b"]:
        """Energy [J] in units of `scale`, per vertex: dimensionless, comparable between grooms."""
        return energy / self.per_vertex_unit


def _compiled(positions: Positions) -> bool:
    return positions.device.type == "cpu" and positions.dtype == torch.float32
