"""The elastic models of the paper by name, behind one interface: what resists gravity and contact in a strand.

    state = elastic_model("cosserat").on(posed, rest_length)
    energy = state.energy(positions, state.unknowns)                         # minimize over both, or, much faster,
    energy = state.energy(positions, state.following(positions, turns))      # over positions and `turns`

The modified model is the default everywhere; the full rod and the springs serve validation and the ablation of Fig. 10.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import torch

from quaffure.config import HairMaterial
from quaffure.energies.cosserat import (
    Quaternions,
    RodStiffness,
    bend_twist_strain,
    carried_frames,
    energy_bend_twist,
    energy_unit_quaternion,
    relative_rotations,
    stretch_shear_strain,
    transported_frames,
)
from quaffure.energies.cosserat import energy_stretch_shear as energy_cosserat_stretch_shear
from quaffure.energies.elastic import energy_stretch, energy_stretch_shear
from quaffure.energies.mass_spring import (
    BEND,
    EDGE,
    TORSION,
    SpringStiffness,
    energy_springs,
    spring_lengths,
    with_ghosts,
)
from quaffure.errors import InputError
from quaffure.geometry.polyline import directors
from quaffure.geometry.rotation import quaternion_multiply
from quaffure.types import EdgeVectors, Energy, Float, Positions, RestLengths, Tensor

Unknowns = Float[Tensor, "b s e u"]


class ElasticState(Protocol):
    """An elastic model on posed strands, whose shape it holds for unstrained.

    Attributes:
        unknowns: what the model needs to know of every edge beside the positions, as on the posed strands; a solver
            minimizes over it too. Its last axis is empty for models of positions alone.
        no_turns: the `turns` of `following` that change nothing.
    """

    @property
    def unknowns(self) -> Unknowns: ...

    @property
    def no_turns(self) -> Unknowns: ...

    def following(self, positions: Positions, turns: Unknowns) -> Unknowns:
        """Unknowns that follow the edges of `positions` [m] from the posed strands, then changed by `turns`.

        A frame is held to its edge a thousand times more stiffly than to its neighbour. With the two moving together
        that stiffness is out of a solver's way.
        """
        ...

    def energy(self, positions: Positions, unknowns: Unknowns) -> Energy:
        """Elastic energy of every sample [J]; a state of one sample serves a batch of positions [m]."""
        ...


class ElasticModel(Protocol):
    """An elastic model with its stiffness."""

    @property
    def name(self) -> str: ...

    def on(self, posed: Positions, rest_length: RestLengths) -> ElasticState:
        """The model on posed strands [m], moved rigidly from rest, whose edges have `rest_length` [m]."""
        ...


@dataclass(frozen=True)
class ModifiedCosserat:
    """Eqs. 6-8. Every edge holds on to its direction on the posed strand; edges do not know of each other."""

    material: HairMaterial = field(default_factory=HairMaterial)
    name: str = "modified_cosserat"

    def on(self, posed: Positions, rest_length: RestLengths) -> ElasticState:
        return _ModifiedCosseratState(self.material, posed, rest_length)


@dataclass(frozen=True)
class Cosserat:
    """Eqs. 2-5. The unknowns are the quaternions of the edges (`wxyz`).

    Eq. 4 sums over pairs of edges alone, which would let a strand turn freely about its root. Here the scalp holds a
    frame too, that of the first edge as posed, and the first edge bends against it over half its length.
    """

    stiffness: RodStiffness = field(default_factory=RodStiffness)
    name: str = "cosserat"

    def on(self, posed: Positions, rest_length: RestLengths) -> ElasticState:
        return _CosseratState(self.stiffness, posed, rest_length)


@dataclass(frozen=True)
class MassSpring:
    """Springs between vertices (`quaffure.energies.mass_spring`)."""

    stiffness: SpringStiffness = field(default_factory=SpringStiffness)
    name: str = "mass_spring"

    def on(self, posed: Positions, rest_length: RestLengths) -> ElasticState:
        return _MassSpringState(self.stiffness, posed)


ELASTIC_MODELS = {"modified_cosserat": ModifiedCosserat, "cosserat": Cosserat, "mass_spring": MassSpring}


def elastic_model(name: str) -> ElasticModel:
    """The model of that name with its default stiffness.

    Raises:
        InputError: no model of that name.
    """
    if name not in ELASTIC_MODELS:
        raise InputError("elastic model", f"one of {', '.join(ELASTIC_MODELS)}", repr(name))
    model: ElasticModel = ELASTIC_MODELS[name]()
    return model


@dataclass(frozen=True, eq=False)
class _ModifiedCosseratState:
    material: HairMaterial
    posed: Positions
    rest_length: RestLengths

    @property
    def unknowns(self) -> Unknowns:
        return _no_unknowns(self.posed)

    no_turns = unknowns

    def following(self, positions: Positions, turns: Unknowns) -> Unknowns:
        return turns

    @cached_property
    def director(self) -> Tensor:
        return directors(self.posed)

    def energy(self, positions: Positions, unknowns: Unknowns) -> Energy:
        director = self.director.expand(len(positions), -1, -1, -1)
        bending = energy_stretch_shear(positions, director, self.rest_length, self.material.k_cosserat)
        return bending + energy_stretch(positions, self.rest_length, self.material.k_stretch)


@dataclass(frozen=True, eq=False)
class _CosseratState:
    stiffness: RodStiffness
    posed: Positions
    rest_length: RestLengths

    @cached_property
    def director(self) -> EdgeVectors:
        return directors(self.posed)

    @cached_property
    def unknowns(self) -> Quaternions:
        return transported_frames(self.director)

    @property
    def no_turns(self) -> Quaternions:
        return self.posed.new_tensor([1.0, 0.0, 0.0, 0.0]).expand_as(self.unknowns)

    def following(self, positions: Positions, turns: Quaternions) -> Quaternions:
        return quaternion_multiply(turns, carried_frames(self.unknowns, self.director, positions))

    @cached_property
    def rest_relative(self) -> Tensor:
        return relative_rotations(self._with_scalp(self.unknowns))

    @cached_property
    def pair_length(self) -> Tensor:
        half = 0.5 * self.rest_length
        return torch.cat([half[:, :1], half[:, 1:] + half[:, :-1]], dim=1)

    def energy(self, positions: Positions, unknowns: Unknowns) -> Energy:
        stretch_shear = stretch_shear_strain(positions, unknowns, self.rest_length)
        relative = relative_rotations(self._with_scalp(unknowns))
        bend_twist = bend_twist_strain(relative, self.rest_relative, self.pair_length)
        return (
            energy_cosserat_stretch_shear(stretch_shear, self.stiffness.k_stretch_shear(self.rest_length))
            + energy_bend_twist(bend_twist, self.stiffness.k_bend_twist(self.pair_length))
            + energy_unit_quaternion(unknowns, self.stiffness.k_unit_quaternion)
        )

    def _with_scalp(self, quaternion: Quaternions) -> Float[Tensor, "b s m 4"]:
        scalp = self.unknowns[:, :, :1].expand(len(quaternion), -1, -1, -1)
        return torch.cat([scalp, quaternion], dim=2)


@dataclass(frozen=True, eq=False)
class _MassSpringState:
    stiffness: SpringStiffness
    posed: Positions

    @property
    def unknowns(self) -> Unknowns:
        return _no_unknowns(self.posed)

    no_turns = unknowns

    def following(self, positions: Positions, turns: Unknowns) -> Unknowns:
        return turns

    @cached_property
    def rest_lengths(self) -> dict[int, Tensor]:
        clamped = with_ghosts(self.posed, self.posed)
        return {reach: spring_lengths(clamped, reach) for reach in (EDGE, BEND, TORSION)}

    def energy(self, positions: Positions, unknowns: Unknowns) -> Energy:
        clamped = with_ghosts(positions, self.posed)
        stiffness = {EDGE: self.stiffness.k_edge, BEND: self.stiffness.k_bend, TORSION: self.stiffness.k_torsion}
        springs = [
            energy_springs(spring_lengths(clamped, reach), self.rest_lengths[reach], k)
            for reach, k in stiffness.items()
        ]
        return torch.stack(springs).sum(dim=0)


def _no_unknowns(posed: Positions) -> Unknowns:
    return posed.new_zeros(*posed.shape[:2], posed.shape[2] - 1, 0)
