"""Gradient-based minimizers: the variables that they move, the loss, and the draper that they share.

The loss is `HairEnergy` in units of `HairEnergy.per_vertex_unit`. Variables of energy terms, as the frame rotations of
the full Cosserat rod, are minimized over together with those of the hair.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable

import torch

from quaffure.config import HairMaterial
from quaffure.draper import StoppingReport
from quaffure.energies.by_name import hair_terms
from quaffure.energies.closed_form import equilibrium_vectors
from quaffure.energies.energy_term import Terms
from quaffure.energies.force_limit import clip_gradients
from quaffure.energies.gravity import Gravity
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.stretch_shear import StretchShear
from quaffure.geometry.polyline import directors, integrate_directions
from quaffure.scene import HairScene
from quaffure.solvers.stopping import stopping_report
from quaffure.types import EdgeVectors, Positions, Tensor


class Directions:
    """Directions of the edges, of any length but zero; edges keep their rest lengths.

    Without vertices to start from, they start as the closed-form gravity equilibrium without contact; without Eqs. 6
    and 9, as posed.

    Attributes:
        values: leaf of the optimizer.
    """

    def __init__(self, energy: HairEnergy, scene: HairScene, start: Positions | None = None) -> None:
        self._roots, self._rest_length = scene.posed[:, :, 0], energy.rest.rest_length
        vectors = _own_start(energy, scene) if start is None else directors(start)
        self.values = torch.nn.functional.normalize(vectors, dim=-1).requires_grad_()

    @torch.no_grad()
    def set_directions(self, vectors: EdgeVectors) -> None:
        """Normalize and set the current values.

        Args:
            vectors: of any length but zero.
        """
        self.values.copy_(torch.nn.functional.normalize(vectors, dim=-1))

    def positions(self) -> Positions:
        return integrate_directions(self._roots, self.values, self._rest_length)


def _own_start(energy: HairEnergy, scene: HairScene) -> EdgeVectors:
    vectors = scene.director.clone()
    if not {StretchShear, Gravity} <= {type(term) for term in energy.terms}:
        return vectors
    rest, k_cosserat = energy.rest, energy.material.k_cosserat
    return equilibrium_vectors(vectors, rest.rest_length, rest.mass_beyond, k_cosserat, energy.acceleration)


class Offsets:
    """Offsets [m] of all vertices but the roots from the posed groom.

    Attributes:
        values: leaf of the optimizer.
    """

    def __init__(self, energy: HairEnergy, scene: HairScene, start: Positions | None = None) -> None:
        self._posed = scene.posed
        self.values = ((scene.posed if start is None else start) - scene.posed)[:, :, 1:].clone().requires_grad_()

    def positions(self) -> Positions:
        return torch.cat([self._posed[:, :, :1], self._posed[:, :, 1:] + self.values], dim=2)


HairVariables = Directions | Offsets
"""What determines the vertices; roots stay on the scalp."""


class Descent:
    """The loss of a scene as a function of its variables.

    Attributes:
        variables: the hair's.
        term_variables: those of energy terms, by the terms' names.
        evaluations: of the loss and its gradient so far.
        clips: limit the force on each vertex (`quaffure.energies.force_limit`).
    """

    def __init__(self, energy: HairEnergy, scene: HairScene, variables: HairVariables, clips: bool = False) -> None:
        self.energy, self.scene, self.variables, self.clips = energy, scene, variables, clips
        initial = energy.initial_variables(scene)
        self.term_variables = {name: value.clone().requires_grad_() for name, value in initial.items()}
        self.evaluations = 0
        self._began = time.perf_counter()

    @property
    def leaves(self) -> list[Tensor]:
        return [self.variables.values, *self.term_variables.values()]

    def loss(self) -> Tensor:
        """Sum over the samples of the energy per vertex [m g L], its gradient left at the leaves."""
        for leaf in self.leaves:
            leaf.grad = None
        positions = self.variables.positions()
        if self.clips:
            positions = positions.view_as(positions)
            clip_gradients(positions, self.energy.rest, self.energy.per_vertex_unit)
        energy = self.energy.total(positions, self.scene, self.term_variables)
        loss = energy.sum() / self.energy.per_vertex_unit
        loss.backward()
        self.evaluations += 1
        return loss

    def finish(self) -> tuple[Positions, StoppingReport]:
        """Vertices [m] of the current variables, and the report."""
        positions = self.variables.positions().detach()
        seconds = time.perf_counter() - self._began
        report = stopping_report(self.energy, self.scene, positions, self.evaluations, seconds, self.term_variables)
        return positions, report


class DescentDraper(ABC):
    """Minimizes `HairEnergy`, of any terms, by its gradient.

    Attributes:
        terms: of the energy.
        variables: what determines the vertices.
        clips: limit the force on each vertex (`quaffure.energies.force_limit`).
    """

    variables: Callable[[HairEnergy, HairScene, Positions | None], HairVariables] = Directions
    clips = False

    def __init__(self, material: HairMaterial | None = None, terms: Terms | None = None) -> None:
        self.material = material or HairMaterial()
        self.terms = hair_terms() if terms is None else terms

    def drape(self, scene: HairScene) -> Positions:
        """Draped vertices of every sample [m, world]."""
        return self.solve(scene)[0]

    def drape_from(self, scene: HairScene, start: Positions) -> Positions:
        """Draped vertices [m] from any drape of the scene."""
        return self._solve(scene, start)[0]

    def solve(self, scene: HairScene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        return self._solve(scene, None)

    def _solve(self, scene: HairScene, start: Positions | None) -> tuple[Positions, StoppingReport]:
        energy = HairEnergy(scene.groom, self.material, self.terms)
        descent = Descent(energy, scene, self.variables(energy, scene, start), self.clips)
        self.minimize(descent)
        return descent.finish()

    @abstractmethod
    def minimize(self, descent: Descent) -> None:
        """Lower the loss of `descent` by changing its variables."""
