"""The objective that training and every solver share, Eq. 1 without the regularization of poses."""

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import torch

from quaffure.backend import Backend, choose_backend
from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.body_collision import BodyCollision
from quaffure.energies.by_name import hair_terms
from quaffure.energies.energy_term import EnergyTerm, HairState, Terms
from quaffure.energies.fused_density import fused_self_collision
from quaffure.energies.fused_strand import TERMS, strand_energy
from quaffure.energies.gravity import NO_ACCELERATION, Gravity
from quaffure.energies.held_parts import goal_weight_of
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.energies.rod_term import Rod
from quaffure.energies.self_collision import SelfCollision
from quaffure.energies.stretch import Stretch
from quaffure.energies.stretch_shear import StretchShear
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.scene import HairScene, check_gradient
from quaffure.types import Energy, Float, Positions, Tensor

Variables = Mapping[str, Tensor]
"""What some terms minimize over in addition to the positions, by their names."""


class HairEnergy:
    """Energy of one groom in any batch of poses: a sum of terms, by default Eq. 8 (Eqs. 6 and 7), Eqs. 9, 10 and 11.

    On `Backend.CPU` one compiled kernel evaluates Eqs. 6, 7, 9 and 10 and another Eq. 11, recognized by the exact types
    of their terms; every other term runs in torch, and on `Backend.TORCH` all do.

    Attributes:
        rest: rest quantities of the groom.
        material: physical parameters.
        terms: the terms of the sum.
        acceleration: of Eq. 9 [m/s^2]; zero without that term.
    """

    def __init__(
        self,
        groom: Groom,
        material: HairMaterial | None = None,
        terms: Terms | None = None,
        backend: Backend | None = None,
    ) -> None:
        """
        Args:
            terms: `hair_terms()` where none are given.
            backend: by the groom's arrays where none is given; `Backend.TORCH` is differentiable in the scene too.

        Raises:
            InputError: two terms of the same name.
        """
        self.material = material or HairMaterial()
        rest = rest_state(groom.rest_strands, self.material)
        goal_weight = goal_weight_of(groom) if groom.held_edges.any() else None
        self.rest: RestState = replace(rest, stiffness_scale=groom.stiffness_scale, goal_weight=goal_weight)
        self.backend = backend or choose_backend(groom.rest_strands)
        terms = hair_terms() if terms is None else tuple(terms)
        for term in terms:
            self.rest = term.adapt_rest(self.rest)
        self._use(terms)

    def only(self, *names: str) -> "HairEnergy":
        """The same energy with the terms of these names alone.

        Raises:
            InputError: there is no term of a name.
        """
        self._check_names(names)
        return copy(self)._use(tuple(term for term in self.terms if term.name in names))

    def without(self, *names: str) -> "HairEnergy":
        """The same energy without the terms of these names.

        Raises:
            InputError: there is no term of a name.
        """
        self._check_names(names)
        return copy(self)._use(tuple(term for term in self.terms if term.name not in names))

    def of_kind(self, kind: type[EnergyTerm]) -> "HairEnergy":
        """The same energy with the terms of this kind alone; there may be none."""
        return copy(self)._use(tuple(term for term in self.terms if isinstance(term, kind)))

    def of_terms(self, terms: Terms) -> "HairEnergy":
        """The same energy with other terms of the same kinds: another stiffness or another acceleration."""
        return copy(self)._use(terms)

    def total(self, positions: Positions, scene: HairScene, variables: Variables | None = None) -> Energy:
        """Sum of all terms [J], differentiable in the positions [m] and the variables.

        Raises:
            ValueError: a gradient is required that is not computed here, or of a term that returns other energies.
        """
        check_gradient(scene)
        energies = []
        if self._on_strands:
            energies.append(self._strand_kernel(positions, scene)[0])
        if self._on_density:
            energies.append(fused_self_collision(positions, self.rest, self.material))
        hair = self._state(positions, scene, variables)
        if self._on_rod:
            energies.append(hair.prepared[Rod.name].fused_energy(positions))
        for term in self._in_torch:
            energies.append(term.energy(hair, scene))
            if energies[-1].shape != (len(positions),):
                raise ValueError(
                    f"energy term {term.name}: expected energies [{len(positions)}], found {list(energies[-1].shape)}"
                )
        return torch.stack(energies).sum(dim=0) if energies else positions.new_zeros(len(positions))

    @torch.no_grad()
    def by_term(self, positions: Positions, scene: HairScene, variables: Variables | None = None) -> dict[str, Energy]:
        """Every term by name [J], without gradient; `only` has the gradient of each."""
        found: dict[str, Energy] = {}
        if self._on_strands:
            found |= zip(TERMS, self._strand_kernel(positions, scene)[1].unbind(1))
        if self._on_density:
            found[SelfCollision.name] = fused_self_collision(positions, self.rest, self.material)
        hair = self._state(positions, scene, variables)
        if self._on_rod:
            found[Rod.name] = hair.prepared[Rod.name].fused_energy(positions)
        found |= {term.name: term.energy(hair, scene) for term in self._in_torch}
        return {term.name: found[term.name] for term in self.terms}

    @torch.no_grad()
    def metrics(
        self, positions: Positions, scene: HairScene, variables: Variables | None = None
    ) -> dict[str, Float[Tensor, " b"]]:
        """Mean metric of every term that has one, by name, in the term's `metric_unit`."""
        hair = self._state(positions, scene, variables)
        found = {term.name: term.metric(hair, scene) for term in self.terms}
        return {name: value.reshape(len(value), -1).mean(dim=1) for name, value in found.items() if value is not None}

    def initial_variables(self, scene: HairScene) -> dict[str, Tensor]:
        """What the terms minimize over in addition to the positions, by their names, at a solver's start."""
        found = {term.name: term.initial_variables(scene) for term in self.terms}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def scale(self) -> float:
        """Energy of lifting an average vertex by its strand's length, m g L [J]: the unit of `excess_energy`."""
        lifted = self.rest.mass * self.rest.strand_length[:, None]
        return STANDARD_GRAVITY * float(lifted.mean())

    @property
    def per_vertex_unit(self) -> float:
        """`scale` times the number of vertices [J]."""
        return self.rest.mass.numel() * self.scale

    def per_vertex(self, energy: Energy) -> Float[Tensor, " b"]:
        """Energy [J] in units of `scale`, per vertex: dimensionless, comparable between grooms."""
        return energy / self.per_vertex_unit

    def _check_names(self, names: tuple[str, ...]) -> None:
        known = [term.name for term in self.terms]
        unknown = [name for name in names if name not in known]
        if unknown:
            raise InputError("energy terms", f"names among {', '.join(known)}", ", ".join(unknown))

    def _use(self, terms: Terms) -> "HairEnergy":
        names = [term.name for term in terms]
        if len(set(names)) < len(names):
            raise InputError("energy terms", "names that differ", ", ".join(names))
        self.terms = terms
        kinds = {type(term) for term in terms} if self.backend is Backend.CPU else set()
        # The strand kernel leaves a term out whose stiffness is 0; weight has no stiffness.
        self._on_strands = kinds & {StretchShear, Stretch, Gravity, BodyCollision} if Gravity in kinds else set()
        self._on_density = kinds & {SelfCollision}
        self._on_rod = kinds & {Rod}
        fused = self._on_strands | self._on_density | self._on_rod
        self._in_torch = [term for term in terms if type(term) not in fused]
        self.acceleration = next((term.acceleration for term in terms if isinstance(term, Gravity)), NO_ACCELERATION)
        stiffness = {"k_cosserat": StretchShear, "k_stretch": Stretch, "k_body_collision": BodyCollision}
        absent = {name: 0.0 for name, kind in stiffness.items() if kind not in self._on_strands}
        self._strand_material = replace(self.material, **absent)
        # By scene: versions of the terms' tensors, and what the terms prepared.
        self._prepared: WeakKeyDictionary[HairScene, tuple[list[int | None], dict[str, Any]]] = WeakKeyDictionary()
        return self

    def _strand_kernel(self, positions: Positions, scene: HairScene) -> tuple[Energy, Float[Tensor, "b 4"]]:
        return strand_energy(
            positions, scene.director, self.rest, self._strand_material, scene.surface, self.acceleration
        )

    def _state(self, positions: Positions, scene: HairScene, variables: Variables | None) -> HairState:
        tensors = [value for term in self.terms for value in vars(term).values() if isinstance(value, Tensor)]
        versions = [None if tensor.is_inference() else tensor._version for tensor in tensors]
        kept = self._prepared.get(scene)
        if kept is None or kept[0] != versions:
            kept = versions, {term.name: term.prepare(self.rest, scene) for term in self.terms}
            # What has a graph serves one gradient, and what was made without gradient none.
            if not any(tensor.requires_grad for tensor in tensors):
                self._prepared[scene] = kept
        return HairState(positions, self.rest, self.material, variables or {}, kept[1])
