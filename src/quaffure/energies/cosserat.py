"""Elastic energy of a strand: the full Cosserat rod of the paper, Eqs. 2-5, with one quaternion an edge.

Quaternions are `wxyz` and take the fixed basis to an edge's material frame: its third axis is the director d3. Edges
have the axis `e`; `p` are the pairs of consecutive quaternions over which Eq. 4 sums. Each energy returns joules per
sample. Discretization after Kugelstadt and Schoemer 2016, "Position and orientation based Cosserat rods".

What the paper's stiffnesses mean. Its strains are per length of the rod, but its sums carry no length, so that each k
is a rod's stiffness times the length that it stands for, and a finer strand of the same hair needs other numbers:

    k_stretch_shear [J]    = stretch-shear stiffness (EA, or GA in shear) [N] x length of the edge
    k_bend_twist    [J m^2] = EI (bending) or GJ (twisting) [N m^2] x length of the pair

`RodStiffness` does that conversion, per edge and pair.
"""

from dataclasses import dataclass, field
from functools import cached_property

import torch

from quaffure.config import BENDING_STIFFNESS, TWISTING_STIFFNESS
from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.energies.rest_state import RestState
from quaffure.geometry.polyline import directors, edges
from quaffure.geometry.rotation import quaternion_from_matrix, quaternion_multiply, shortest_arc
from quaffure.scene import HairScene
from quaffure.types import EdgeVectors, Energy, Float, Positions, RestLengths, Tensor

Quaternions = Float[Tensor, "b s e 4"]
PairRotations = Float[Tensor, "b s p 4"]
PairStrains = Float[Tensor, "b s p 3"]


@dataclass(frozen=True)
class RodStiffness:
    """Stiffness of a rod, independent of its discretization.

    The defaults are those of a real hair in bending and twisting; in stretch they are those that Eq. 7 gives a strand
    by default, a thousandth of a real hair's 20 N: enough to stretch by less than 0.2 %.
    """

    stretch_shear: float = 0.02
    """Against stretch and shear alike (EA and GA) [N]."""
    bend: float = BENDING_STIFFNESS
    """Against bending, in both directions (EI) [N m^2]."""
    twist: float = TWISTING_STIFFNESS
    """Against twisting (GJ) [N m^2]."""
    k_unit_quaternion: float = 0.01
    """Eq. 5 [J]; an edge may shrink its quaternion instead of stretching unless this far exceeds 4 k_stretch_shear."""

    def k_stretch_shear(self, rest_length: RestLengths) -> RestLengths:
        """The paper's k_stretch_shear of every edge [J]."""
        return self.stretch_shear * rest_length

    def k_bend_twist(self, pair_length: Float[Tensor, "s p"]) -> Float[Tensor, "s p 3"]:
        """The paper's k_bend_twist of every pair [J m^2]: about d1, d2 (bending) and d3 (twisting).

        The paper prints one number, so bend = twist; a round rod of Poisson's ratio nu has bend / twist = 1 + nu.
        """
        return pair_length[..., None] * pair_length.new_tensor([self.bend, self.bend, self.twist])


def transported_frames(director: EdgeVectors) -> Quaternions:
    """Unit quaternions of frames that follow the directors d3 without twist (parallel transport).

    The first frame rotates e3 to its director by the smallest angle; where it points about d3 has no effect on the
    energy, which bends alike in all directions.
    """
    first, later = director[..., :1, :], director[..., 1:, :]
    e3 = director.new_tensor([0.0, 0.0, 1.0])
    rotations = quaternion_from_matrix(
        shortest_arc(torch.cat([e3.expand_as(first), director[..., :-1, :]], -2), director)
    )
    frames = [rotations[..., 0, :]]
    for edge in range(1, later.shape[-2] + 1):
        frames.append(quaternion_multiply(rotations[..., edge, :], frames[-1]))
    return torch.stack(frames, dim=-2)


def edge_aligned_frames(frames: Quaternions, director: EdgeVectors, positions: Positions) -> Quaternions:
    """`frames`, whose third axes are the directors, each rotated by the smallest angle to align with its edge.

    Without a direction, and zero here, where an edge points exactly against its director.
    """
    tangent = torch.nn.functional.normalize(edges(positions), dim=-1)
    aligned = 1 + (director * tangent).sum(-1, keepdim=True)
    arc = torch.cat([aligned, torch.linalg.cross(director.expand_as(tangent), tangent)], dim=-1)
    return quaternion_multiply(torch.nn.functional.normalize(arc, dim=-1), frames.expand(*arc.shape))


def third_axis(quaternion: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3"]:
    """Im(q e3 conj(q)), the director of a quaternion: of length |q|^2."""
    w, x, y, z = quaternion.unbind(-1)
    return torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], dim=-1)


def relative_rotations(quaternion: Float[Tensor, "*batch m 4"]) -> Float[Tensor, "*batch p 4"]:
    """conj(q_i) q_{i+1} of each consecutive pair, in the frame of the first."""
    conjugate = quaternion[..., :-1, :] * quaternion.new_tensor([1.0, -1.0, -1.0, -1.0])
    return quaternion_multiply(conjugate, quaternion[..., 1:, :])


def cosserat_stretch_shear_strain(
    positions: Positions, quaternion: Quaternions, rest_length: RestLengths
) -> EdgeVectors:
    """Stretch-shear strain (Gamma, below Eq. 3), dimensionless, in the world's axes."""
    return edges(positions) / rest_length[..., None] - third_axis(quaternion)


def nearer_sign(relative: PairRotations, rest_relative: Float[Tensor, "#b s p 4"]) -> PairRotations:
    """`relative` or its negative, which is the same rotation: the one nearer to `rest_relative`.

    "Nearer" must be taken in all four components. With the imaginary parts alone, as Eq. 4 might be read, a pair that
    is bent by its rest angle to the wrong side counts as unbent.
    """
    aligned = (relative * rest_relative).sum(-1, keepdim=True) >= 0
    return torch.where(aligned, relative, -relative)


def bend_twist_strain(
    relative: PairRotations, rest_relative: Float[Tensor, "#b s p 4"], pair_length: Float[Tensor, "s p"]
) -> PairStrains:
    """Bend-twist strain (Omega, below Eq. 4) [1/m], in the axes of the pair's first frame.

    Args:
        relative: conj(q_i) q_{i+1} now, of either sign; `rest_relative` at rest.
        pair_length: from the middle of one edge to that of the next (l_rest; the paper does not say of which edge) [m].
    """
    return 2 / pair_length[..., None] * (nearer_sign(relative, rest_relative) - rest_relative)[..., 1:]


def energy_cosserat_stretch_shear(strain: EdgeVectors, k_stretch_shear: Float[Tensor, "#s #e"]) -> Energy:
    """Eq. 3: half k_stretch_shear [J] times the squared strain of every edge."""
    return 0.5 * (k_stretch_shear * strain.square().sum(-1)).sum(dim=(-2, -1))


def energy_bend_twist(strain: PairStrains, k_bend_twist: Float[Tensor, "#s #p #3"]) -> Energy:
    """Eq. 4: half k_bend_twist [J m^2] times the squared strain [1/m^2] of every pair, one stiffness an axis."""
    return 0.5 * (k_bend_twist * strain.square()).sum(dim=(-3, -2, -1))


def energy_unit_quaternion(quaternion: Quaternions, k_unit_quaternion: float) -> Energy:
    """Eq. 5: half k_unit_quaternion [J] times the squared excess of every quaternion's length over one."""
    return 0.5 * k_unit_quaternion * (quaternion.norm(dim=-1) - 1).square().sum(dim=(-2, -1))


def strain_angles(relative: PairRotations, rest_relative: Float[Tensor, "#b s p 4"]) -> Float[Tensor, "b s p"]:
    """Metric of Eq. 4: angle by which every pair of unit quaternions is rotated from its rest [deg]."""
    chord = (nearer_sign(relative, rest_relative) - rest_relative).norm(dim=-1)
    return torch.rad2deg(4 * torch.asin((chord / 2).clamp(max=1)))


@dataclass(frozen=True, eq=False)
class CosseratRod:
    """Eqs. 2-5 on posed strands [m], moved rigidly from rest, where they are unstrained.

    Eq. 4 sums over pairs of edges alone, which would let a strand rotate freely about its root. Here the scalp holds a
    frame too, that of the first edge as posed, and the first edge bends against it over half its length.
    """

    stiffness: RodStiffness
    posed: Positions
    rest_length: RestLengths

    @cached_property
    def director(self) -> EdgeVectors:
        return directors(self.posed)

    @cached_property
    def frames(self) -> Quaternions:
        """Frames of the posed edges."""
        return transported_frames(self.director)

    @cached_property
    def pair_length(self) -> Float[Tensor, "s p"]:
        half = 0.5 * self.rest_length
        return torch.cat([half[:, :1], half[:, 1:] + half[:, :-1]], dim=1)

    @cached_property
    def rest_relative(self) -> PairRotations:
        return self.relative(self.frames)

    def relative(self, quaternion: Quaternions) -> PairRotations:
        """Relative rotations of all pairs, the scalp's frame with the first edge included."""
        scalp = self.frames[:, :, :1].expand(len(quaternion), -1, -1, -1)
        return relative_rotations(torch.cat([scalp, quaternion], dim=2))

    def energy(self, positions: Positions, quaternion: Quaternions) -> Energy:
        """Eq. 2, the sum of Eqs. 3-5 [J]; a rod of one sample serves a batch of positions [m]."""
        gamma = cosserat_stretch_shear_strain(positions, quaternion, self.rest_length)
        omega = bend_twist_strain(self.relative(quaternion), self.rest_relative, self.pair_length)
        return (
            energy_cosserat_stretch_shear(gamma, self.stiffness.k_stretch_shear(self.rest_length))
            + energy_bend_twist(omega, self.stiffness.k_bend_twist(self.pair_length))
            + energy_unit_quaternion(quaternion, self.stiffness.k_unit_quaternion)
        )


@dataclass(frozen=True)
class Cosserat(EnergyTerm):
    """Eqs. 2-5. Its variables are rotations (`wxyz`) of the edges' frames against their edges.

    A frame is held to its edge a thousand times more stiffly than to its neighbour. With the two moving together that
    stiffness does not slow a solver. Without variables the frames follow their edges without twist.
    """

    name = "elastic"
    equation = "Eqs. 2-5"
    metric_unit = "deg"
    stiffness: RodStiffness = field(default_factory=RodStiffness)

    def prepare(self, rest: RestState, scene: HairScene) -> CosseratRod:
        posed = rest.posed_from_root(scene.director)
        return CosseratRod(self.stiffness, posed, rest.rest_length.to(posed))

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        # Relative to the roots: elasticity is local, and float32 has more digits there.
        rod: CosseratRod = hair.prepared[self.name]
        return rod.energy(hair.positions - hair.positions[:, :, :1], self.frames(hair))

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s p"]:
        rod: CosseratRod = hair.prepared[self.name]
        return strain_angles(rod.relative(self.frames(hair)), rod.rest_relative)

    def initial_variables(self, scene: HairScene) -> Quaternions:
        identity = scene.director.new_tensor([1.0, 0.0, 0.0, 0.0])
        return identity.expand(*scene.director.shape[:3], 4)

    def frames(self, hair: HairState) -> Quaternions:
        """Quaternions of the edges: aligned with them, then rotated by the term's variables."""
        rod: CosseratRod = hair.prepared[self.name]
        aligned = edge_aligned_frames(rod.frames, rod.director, hair.positions)
        return quaternion_multiply(hair.variables[self.name], aligned) if self.name in hair.variables else aligned
