"""One sample's energy in double precision, and a quadratic model of it round a point."""

from copy import copy
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import HairScene
from quaffure.solvers.newton.block_tridiagonal import solve_strands
from quaffure.solvers.newton.density_hessian import density_blocks, density_change, density_force, density_product
from quaffure.solvers.newton.density_pairs import pressed_pairs
from quaffure.solvers.newton.density_particles import DensityParticles, density, density_gradient, density_particles
from quaffure.solvers.newton.rounded_contact import body_arrays
from quaffure.solvers.newton.strand_hessian import Hair, StrandSystem, hair_arrays
from quaffure.solvers.newton.strand_newton import factor_strands, linearize_strands, multiply_strands, strand_energies

Vertices = Float[np.ndarray, "s n 3"]
PerStrand = Float[np.ndarray, " s"]
PerVertex = Float[np.ndarray, "s n"]


class Point(NamedTuple):
    """Vertices and what they cost.

    Attributes:
        positions: of the strands that move [m].
        strand_energy: Eqs. 6, 7, 9 and 10 of every strand [J].
        excess: rho - rho_rest of every vertex [kg/m^3].
        density_energy: Eq. 11 of every vertex [J].
        particles: the vertices sorted into cells.
        fixed_excess: of the vertices of all other strands, in their sorted order [kg/m^3].
        energy: sum of all terms, over the strands that are held too [J].
    """

    positions: Vertices
    strand_energy: PerStrand
    excess: PerVertex
    density_energy: PerVertex
    particles: DensityParticles
    fixed_excess: Float[np.ndarray, " q"]
    energy: float


class NewtonSystem:
    """`HairEnergy` of one sample of a scene, in float64 and with the body's concave edges rounded (`rounded_contact`).

    Attributes:
        evaluations: of the energy or its derivatives by this system, so far; with some of the strands in proportion.
            What found the point to start from is not in it.
        weight: norm of gravity's gradient over all free vertices of the groom [N].
        fixed_neighbours: the vertices of the strands that are held, if some are.
    """

    def __init__(self, energy: HairEnergy, scene: HairScene, sample: int) -> None:
        self.k_self_collision = energy.material.k_self_collision
        self.smoothing_length = energy.material.smoothing_length
        self.evaluations = 0.0
        self.hair = hair_arrays(energy, scene.director[sample])
        self.body = body_arrays(scene.surface, sample)
        self.rest_density: PerVertex = energy.rest.rest_density.double().numpy()
        # Where the search for each vertex's nearest face starts.
        self.leaves = np.zeros(self.rest_density.shape, np.int64)
        self.weight = STANDARD_GRAVITY * float(np.linalg.norm(self.hair.mass[:, 1:]))
        self.fixed_neighbours: DensityParticles | None = None
        self._held_excess, self._held_energy = np.empty(0), 0.0

    def of_strands(self, strands: Int[np.ndarray, " k"], point: Point) -> "NewtonSystem":
        """The same energy as a function of some strands alone, the rest held where it is at a point of all.

        What it costs to evaluate is in proportion to the strands. Hair that is held is still pressed: its densities
        follow those that move.
        """
        part = copy(self)
        director, rest_length, mass, margin = (field[strands] for field in self.hair[:4])
        part.hair = Hair(director, rest_length, mass, margin, self.hair.stiffness)
        part.rest_density, part.leaves = self.rest_density[strands], self.leaves[strands]
        part.evaluations = 0.0
        moving = np.zeros(point.excess.shape, np.bool_)
        moving[strands] = True
        moving = moving.ravel()[point.particles.order]
        part.fixed_neighbours = point.particles.of(~moving)
        found = point.excess.ravel()[point.particles.order][~moving]
        part._held_energy = float(np.delete(point.strand_energy, strands).sum())
        part._held_excess = found - density(part.fixed_neighbours, point.particles.of(moving))
        return part

    def point(self, positions: Vertices) -> Point:
        """All terms of the energy at vertices [m].

        Raises:
            ValueError: one is not finite.
        """
        self.evaluations += 1
        points, mass = positions.reshape(-1, 3), self.hair.mass.ravel()
        grid = self.fixed_neighbours.grid if self.fixed_neighbours else None
        particles = density_particles(points, mass, self.smoothing_length, grid)
        strands = np.empty(len(positions))
        strand_energies(positions, self.hair, self.body, self.leaves, strands)
        found, fixed_excess = density(particles), self._held_excess
        if self.fixed_neighbours:
            found += density(particles, self.fixed_neighbours)
            fixed_excess = fixed_excess + density(self.fixed_neighbours, particles)
        excess = np.empty(self.rest_density.size)
        excess[particles.order] = found
        excess = excess.reshape(self.rest_density.shape) - self.rest_density
        density_energy = self.energy_of_excess(excess)
        of_densities = float(density_energy.sum() + self.energy_of_excess(fixed_excess).sum())
        energy = float(strands.sum()) + of_densities + self._held_energy
        return Point(positions, strands, excess, density_energy, particles, fixed_excess, energy)

    def joined(self, point: Point, strands: Int[np.ndarray, " k"], part: "NewtonSystem", reached: Point) -> Point:
        """The point of all where some strands have moved on, as a part knows it: nothing is evaluated again."""
        positions, strand_energy, excess = point.positions.copy(), point.strand_energy.copy(), point.excess.copy()
        positions[strands], strand_energy[strands] = reached.positions, reached.strand_energy
        if part.fixed_neighbours:
            excess.ravel()[part.fixed_neighbours.order] = reached.fixed_excess
        excess[strands] = reached.excess
        density_energy = self.energy_of_excess(excess)
        particles = density_particles(positions.reshape(-1, 3), self.hair.mass.ravel(), self.smoothing_length)
        energy = float(strand_energy.sum() + density_energy.sum())
        return Point(positions, strand_energy, excess, density_energy, particles, point.fixed_excess, energy)

    def strand_gradient(self, point: Point) -> Vertices:
        """Gradient of all terms but Eq. 11, zero at the roots [N]."""
        return self.linearized(point, 1.0).gradient

    def linearized(self, point: Point, exactness: float) -> StrandSystem:
        """Gradient and Hessian of all terms but Eq. 11; `exactness` as in `strand_hessian`."""
        shape = point.positions.shape
        system = StrandSystem(np.empty(shape), np.empty((*shape, 3)), np.empty((shape[0], shape[1] - 1, 3, 3)))
        linearize_strands(point.positions, self.hair, self.body, self.leaves, exactness, system)
        return system

    def density_energy_gradient(self, point: Point) -> Vertices:
        """Gradient of Eq. 11 at a point of all strands, zero at the roots [N]."""
        pressure = 3 * self.k_self_collision * point.excess.clip(min=0).ravel()[point.particles.order] ** 2
        gradient = np.empty(point.positions.shape)
        gradient.reshape(-1, 3)[point.particles.order] = density_gradient(point.particles, pressure)
        gradient[:, 0] = 0.0
        return gradient

    def energy_of_excess(self, excess: np.ndarray) -> np.ndarray:
        """Eq. 11 of vertices with an excess of density [J]."""
        above = excess.clip(min=0)
        return self.k_self_collision * above * above * above


class QuadraticModel:
    """A quadratic model of the energy round a point: the exact gradient, and a Hessian that is made convex in part.

    Far from a minimum the energy is not convex: compressed edges, edges of the body, and pairs of vertices that push
    each other apart have negative curvature. A convex model keeps of them what is positive; it always has a minimum,
    but is too stiff.

    Args:
        point: with its energy.
        slack: by how much every density may rise before the step ends [kg/m^3]: hair that does not touch yet resists as
            if it did so by that much. Without it a step runs far into hair that the model cannot see.
        exactness: 1 for the exact Hessian, then without slack; 0 for a convex one; shares of both in between.
        damping: what every vertex resists by itself to any move, of what an edge's bending resists.

    Attributes:
        gradient: of all terms, exact, zero at the roots [N].
    """

    def __init__(
        self, system: NewtonSystem, point: Point, slack: PerVertex, exactness: float, damping: float = 0.0
    ) -> None:
        system.evaluations += 1
        self.point, self._k = point, system.k_self_collision
        self._reserve: PerVertex = (point.excess + (1.0 - exactness) * slack).clip(min=0)
        self._own, self._diagonal, self._coupling = system.linearized(point, exactness)
        bending = system.hair.stiffness[0] / system.hair.rest_length**2
        self._diagonal[:, 1:] += damping * bending[:, :, None, None] * np.eye(3)
        fixed_excess = point.fixed_excess.clip(min=0)
        pressure = 3 * self._k * np.concatenate([self._sorted(point.excess.clip(min=0)), fixed_excess]) ** 2
        stiffness = 6 * self._k * np.concatenate([self._sorted(self._reserve), fixed_excess])
        self._pairs = pressed_pairs(point.particles, pressure, stiffness, exactness, system.fixed_neighbours)
        moving = point.excess.size
        self.gradient = self._own + self._unsorted(density_force(self._pairs, pressure, moving))
        self._pivots = np.empty_like(self._diagonal)
        blocks_of_all = self._diagonal + self._unsorted(density_blocks(self._pairs, moving))
        factor_strands(blocks_of_all, self._coupling, self._pivots)

    def product(self, step: Vertices) -> Vertices:
        """The model's Hessian times a step."""
        product = np.empty_like(step)
        multiply_strands(self._diagonal, self._coupling, step, product)
        return product + self._unsorted(density_product(self._pairs, self._sorted(step)))

    def precondition(self, force: Vertices) -> Vertices:
        """Solve with every strand's own part of the Hessian, its neighbours standing still."""
        solution = np.empty_like(force)
        solve_strands(self._coupling, self._pivots, force, solution)
        return solution

    def predicted(self, step: Vertices) -> "PredictedReduction":
        """What the model says along a step."""
        product = np.empty_like(step)
        multiply_strands(self._diagonal, self._coupling, step, product)
        change = self._unsorted(density_change(self._pairs, self._sorted(step))[: self.point.excess.size])
        return PredictedReduction(
            slope=(self._own * step).sum((1, 2)),
            curvature=(step * product).sum((1, 2)),
            density_slope=3 * self._k * (self.point.excess.clip(min=0) ** 2 * change).sum(1),
            density_curvature=6 * self._k * (self._reserve * change**2).sum(1),
        )

    def _sorted(self, values: np.ndarray) -> np.ndarray:
        """Values of vertices [s, n, ...] in the sorted order."""
        return values.reshape(-1, *values.shape[2:])[self.point.particles.order]

    def _unsorted(self, values: np.ndarray) -> np.ndarray:
        """Back from the sorted order; vectors and blocks are zero at the roots."""
        back = np.empty_like(values)
        back[self.point.particles.order] = values
        back = back.reshape(*self._own.shape[:2], *values.shape[1:])
        if values.ndim > 1:
            back[:, 0] = 0.0
        return back


class PredictedReduction(NamedTuple):
    """What a model says of every strand along a step.

    Attributes:
        slope, curvature: first and second derivative of the strand's own energy by the share of the step taken [J].
        density_slope, density_curvature: of Eq. 11 of its vertices, the curvature without that of the kernel [J].
    """

    slope: PerStrand
    curvature: PerStrand
    density_slope: PerStrand
    density_curvature: PerStrand

    def model_error(self, start: Point, length: PerStrand, reached: Point) -> PerStrand:
        """By how much every strand costs more than predicted after a share of the step, both parts by itself [J].

        Args:
            length: share that each strand took.
        """
        own = length * self.slope + 0.5 * length**2 * self.curvature
        particles = length * self.density_slope + 0.5 * length**2 * self.density_curvature
        in_strand = reached.strand_energy - start.strand_energy - own
        in_density = (reached.density_energy - start.density_energy).sum(1) - particles
        return in_strand.clip(min=0) + in_density.clip(min=0)
