"""Elastic energy of a strand: springs between its vertices, for the ablation of the paper's Fig. 10.

After Selle, Lentine and Fedkiw 2008, "A mass spring model for hair simulation": edge springs join neighbours, bending
springs every second vertex, torsion springs every third; all linear, as stiff as their material (force = k times the
relative change of length). Of their model this leaves out the altitude springs and the extra particles that they add
to straight hair; so four vertices can mirror into each other, and a straight strand resists bending with the cube
of the angle only. Those are the known weaknesses of springs along a hair, and what the ablation shows.
"""

from dataclasses import dataclass, field
from functools import cached_property

import torch

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.energies.rest_state import RestState
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Positions, Tensor

EDGE, BEND, TORSION = 1, 2, 3
"""How many vertices a spring of each kind reaches."""


@dataclass(frozen=True)
class SpringStiffness:
    """Stiffness of the springs: force per relative change of length [N].

    A bending spring over two edges of length l, with the angle a between them at rest, is to first order as
    stiff as a rod of EI = k_bend l^2 sin(a/2)^2 / (2 cos(a/2)): nothing where the strand is straight.
    """

    k_edge: float = 0.02
    """Between neighbours [N]."""
    k_bend: float = 1e-3
    """Between every second vertex [N]."""
    k_torsion: float = 1e-3
    """Between every third vertex [N]."""

    def by_reach(self) -> dict[int, float]:
        """Every stiffness by how many vertices its springs reach."""
        return {EDGE: self.k_edge, BEND: self.k_bend, TORSION: self.k_torsion}


def with_ghosts(positions: Positions, posed: Float[Tensor, "#b s n 3"]) -> Float[Tensor, "b s m 3"]:
    """The vertices after two more that clamp the root: the posed strand mirrored through its root, fixed to the head.

    Without them a strand would rotate freely about its root.
    """
    ghosts = 2 * posed[:, :, :1] - posed[:, :, 1:3].flip(2)
    return torch.cat([ghosts.expand(len(positions), -1, -1, -1), positions], dim=2)


def spring_lengths(vertices: Float[Tensor, "b s m 3"], reach: int) -> Float[Tensor, "b s k"]:
    """Distance [m] from every vertex to the one `reach` further on."""
    return (vertices[:, :, reach:] - vertices[:, :, :-reach]).norm(dim=-1)


def energy_springs(length: Float[Tensor, "b s k"], rest_length: Float[Tensor, "#b s k"], stiffness: float) -> Energy:
    """Half `stiffness` [N] times rest length times squared relative change of length, over all springs [J]."""
    return 0.5 * stiffness * ((length - rest_length).square() / rest_length).sum(dim=(-2, -1))


@dataclass(frozen=True, eq=False)
class Springs:
    """Springs on posed strands [m], moved rigidly from rest, where they are at their rest lengths."""

    stiffness: SpringStiffness
    posed: Positions

    @cached_property
    def rest_lengths(self) -> dict[int, Float[Tensor, "b s k"]]:
        return self.lengths(self.posed)

    def lengths(self, positions: Positions) -> dict[int, Float[Tensor, "b s k"]]:
        """Lengths of all springs [m] by their reach."""
        # Relative to the roots: elasticity is local, and float32 has more digits there.
        clamped = with_ghosts(positions - positions[:, :, :1] + self.posed[:, :, :1], self.posed)
        return {reach: spring_lengths(clamped, reach) for reach in (EDGE, BEND, TORSION)}

    def energy(self, positions: Positions) -> Energy:
        """Energy of all springs [J]; springs of one sample serve a batch of positions [m]."""
        lengths, stiffness = self.lengths(positions), self.stiffness.by_reach()
        springs = [energy_springs(lengths[reach], self.rest_lengths[reach], k) for reach, k in stiffness.items()]
        return torch.stack(springs).sum(dim=0)


@dataclass(frozen=True)
class MassSpring(EnergyTerm):
    """Edge, bending and torsion springs."""

    name = "elastic"
    equation = "Selle et al. 2008"
    metric_unit = "%"
    stiffness: SpringStiffness = field(default_factory=SpringStiffness)

    def prepare(self, rest: RestState, scene: HairScene) -> Springs:
        return Springs(self.stiffness, rest.posed_from_root(scene.director))

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        springs: Springs = hair.prepared[self.name]
        return springs.energy(hair.positions)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s k"]:
        """Relative change of length of every edge's spring [%]."""
        springs: Springs = hair.prepared[self.name]
        return 100 * (springs.lengths(hair.positions)[EDGE] / springs.rest_lengths[EDGE] - 1).abs()
