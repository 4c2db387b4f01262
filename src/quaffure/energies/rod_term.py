"""The elastic model `rod` as a term of `HairEnergy`: a Kirchhoff rod at the equilibrium of its twist."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.energies.rest_state import RestState
from quaffure.energies.rod import (
    RodRest,
    RootRotations,
    check_stiffness,
    energy_rod,
    equilibrium_twist,
    rest_targets,
)
from quaffure.energies.rod_kernels import RodArrays, fused_rod, rod_arrays
from quaffure.energies.sag_free import SagFreeRest
from quaffure.errors import InputError
from quaffure.geometry.polyline import directors
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Positions, Tensor


@dataclass(frozen=True, eq=False)
class PosedRod:
    """The rods of a groom on posed bodies."""

    rest: RodRest
    rotation: RootRotations

    @cached_property
    def arrays(self) -> RodArrays:
        """The rest shape as kernels read it.

        Raises:
            ValueError: the gradient by the stiffness is asked for.
        """
        if torch.is_grad_enabled() and self.rest.bending_stiffness.requires_grad:
            raise ValueError("expected stiffness without gradient: `Backend.TORCH` differentiates it")
        return rod_arrays(self.rest, self.rest.rest_twist.dtype)

    def fused_energy(self, positions: Positions) -> Energy:
        """The rods' energy [J] by the compiled kernel, differentiable in the positions [m] alone."""
        return fused_rod(positions, self.arrays, self.rotation)


@dataclass(frozen=True)
class Rod(EnergyTerm):
    """Bending and twisting of a Kirchhoff rod (`quaffure.energies.rod`), to be used with Eq. 7.

    Attributes:
        design: rest shape of one groom that keeps it as designed (`sag_free_rest`), with the collision margins that
            belong to it; without it, every groom is free of stress as it is, and gravity bends it from there, held
            parts apart.
        stiffness: multiple of the bending and twisting stiffness, of all edges or of each [s e]. The rest shape stays.
    """

    name = "elastic"
    equation = "Bergou et al. 2008"
    metric_unit = "deg"
    design: SagFreeRest | None = None
    stiffness: float | Float[Tensor, "s e"] = 1.0

    def __post_init__(self) -> None:
        check_stiffness(self.stiffness)

    def adapt_rest(self, rest: RestState) -> RestState:
        """With the collision margins of the design, and with `RestState.held`.

        In a tie strands are so close that the small changes of a posed scalp would press them apart with all force.

        Raises:
            InputError: the design is that of another groom, or the stiffness not one number nor one of each edge.
        """
        goal, edges = rest.goal_weight, tuple(rest.rest_length.shape)
        if isinstance(self.stiffness, Tensor) and tuple(self.stiffness.shape) != edges:
            raise InputError("stiffness", f"a number or one of each edge, {edges}", f"{tuple(self.stiffness.shape)}")
        if self.design is not None:
            margin, goal = self.design.collision_margin, self.design.rod.goal_weight
            if margin.shape != rest.collision_margin.shape:
                expected, found = (tuple(values.shape) for values in (margin, rest.collision_margin))
                raise InputError("sag-free rest shape", f"the groom that it was made for, {expected}", f"{found}")
            rest = replace(rest, collision_margin=margin.to(rest.collision_margin))
        if goal is None:
            return rest
        return replace(rest, held=torch.nn.functional.pad(goal > 0, (1, 0)).to(rest.collision_margin.device))

    def prepare(self, rest: RestState, scene: HairScene) -> PosedRod:
        rod = (rest.stress_free_rod if self.design is None else self.design.rod).stiffened(self.stiffness)
        return PosedRod(rod.to(scene.posed.dtype).to(scene.posed.device), scene.root_rotation.to(scene.posed))

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        rod: PosedRod = hair.prepared[self.name]
        return energy_rod(hair.positions, rod.rest, rod.rotation)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s e"]:
        """Angle by which each joint is bent from its rest shape."""
        rod: PosedRod = hair.prepared[self.name]
        direction = directors(hair.positions)
        twist = equilibrium_twist(direction, rod.rest, rod.rotation)
        chord = (direction - rest_targets(direction, twist, rod.rest, rod.rotation)).norm(dim=-1)
        return torch.rad2deg(2 * torch.asin((chord / 2).clamp(max=1)))
