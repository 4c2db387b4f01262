"""What descents by the gradient share: the variables that they move, the loss, and how they end.

The loss is `HairEnergy` in units of `HairEnergy.per_vertex_unit`. Where the elastic model has unknowns, the
quaternions of the full Cosserat rod, their turns against the edges (`ElasticState.following`) are variables too.
"""

import time
from typing import Protocol, runtime_checkable

import torch

from quaffure.draper import StoppingReport
from quaffure.energies.closed_form import equilibrium_vectors
from quaffure.energies.elastic_model import ModifiedCosserat
from quaffure.energies.force_limit import clip_gradients
from quaffure.energies.hair_energy import HairEnergy
from quaffure.geometry.polyline import integrate_directions
from quaffure.scene import Scene
from quaffure.solvers.stopping import stopping_report
from quaffure.types import EdgeVectors, Positions, Tensor


@runtime_checkable
class HairVariables(Protocol):
    """What moves the vertices.

    Attributes:
        values: leaf of the optimizer.
    """

    @property
    def values(self) -> Tensor: ...

    def positions(self) -> Positions:
        """Vertices [m], differentiable in `values`; roots are where the scalp has them."""
        ...


class Directions:
    """Directions of the edges, of any length but zero; edges keep their rest lengths.

    They start as the closed-form sag, the minimum where nothing touches; with other elastic models, as posed.
    """

    def __init__(self, energy: HairEnergy, scene: Scene) -> None:
        self._roots, self._rest_length = scene.posed[:, :, 0], energy.rest.rest_length
        start = scene.director.clone()
        if isinstance(energy.elastic, ModifiedCosserat):
            start = equilibrium_vectors(start, self._rest_length, energy.rest.mass_beyond, energy.material.k_cosserat)
        self.values = torch.nn.functional.normalize(start, dim=-1).requires_grad_()

    @torch.no_grad()
    def turn_to(self, vectors: EdgeVectors) -> None:
        """Point along vectors of any length but zero, from here on."""
        self.values.copy_(torch.nn.functional.normalize(vectors, dim=-1))

    def positions(self) -> Positions:
        return integrate_directions(self._roots, self.values, self._rest_length)


class Offsets:
    """Offsets [m] of all vertices but the roots from the posed groom."""

    def __init__(self, energy: HairEnergy, scene: Scene) -> None:
        self._posed = scene.posed
        self.values = torch.zeros_like(scene.posed[:, :, 1:]).requires_grad_()

    def positions(self) -> Positions:
        return torch.cat([self._posed[:, :, :1], self._posed[:, :, 1:] + self.values], dim=2)


class Descent:
    """The loss of a scene as a function of its variables.

    Attributes:
        variables: the hair's.
        turns: the elastic model's; the last axis may be empty.
        evaluations: of the loss and its gradient so far.
    """

    def __init__(self, energy: HairEnergy, scene: Scene, variables: HairVariables, limited: bool = False) -> None:
        self.energy, self.scene, self.variables, self._limited = energy, scene, variables, limited
        self.turns = energy.no_turns(scene.director).clone().requires_grad_()
        self.evaluations = 0
        self._began = time.perf_counter()

    @property
    def leaves(self) -> list[Tensor]:
        return [self.variables.values, *([self.turns] if self.turns.numel() else [])]

    def loss(self) -> Tensor:
        """Sum over the samples of the energy per vertex [m g L], its gradient left at the leaves."""
        for leaf in self.leaves:
            leaf.grad = None
        positions = self.variables.positions()
        if self._limited:
            positions = clip_gradients(positions, self.energy.rest, self.energy.per_vertex_unit)
        director = self.scene.director
        unknowns = self.energy.following(positions, director, self.turns)
        energy = self.energy.total(positions, director, self.scene.surface, unknowns)
        loss = energy.sum() / self.energy.per_vertex_unit
        loss.backward()
        self.evaluations += 1
        return loss

    def finish(self) -> tuple[Positions, StoppingReport]:
        """Vertices [m] where the variables are now, and the report."""
        positions = self.variables.positions().detach()
        unknowns = self.energy.following(positions, self.scene.director, self.turns)
        seconds = time.perf_counter() - self._began
        return positions, stopping_report(self.energy, self.scene, positions, self.evaluations, seconds, unknowns)
