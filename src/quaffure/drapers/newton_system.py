"""One sample's energy in double precision, and a quadratic model of it round a point."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from quaffure.config import STANDARD_GRAVITY
from quaffure.drapers.scene import Scene
from quaffure.energies.block_tridiagonal import solve_strands
from quaffure.energies.density_hessian import (
    Crowd,
    crowd_of,
    density,
    density_blocks,
    density_change,
    density_force,
    density_product,
    pressed,
)
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.rounded_contact import body_arrays
from quaffure.energies.strand_hessian import hair_arrays
from quaffure.energies.strand_newton import factor_strands, linearize_strands, multiply_strands, strand_energies

Vertices = Float[np.ndarray, "s n 3"]
PerStrand = Float[np.ndarray, " s"]
PerVertex = Float[np.ndarray, "s n"]


class Point(NamedTuple):
    """Vertices and what they cost.

    Attributes:
        positions: [m].
        strand_energy: Eqs. 6, 7, 9 and 10 of every strand [J].
        excess: rho - rho_rest of every vertex [kg/m^3].
        crowding: Eq. 11 of every vertex [J].
        crowd: the vertices sorted into cells.
    """

    positions: Vertices
    strand_energy: PerStrand
    excess: PerVertex
    crowding: PerVertex
    crowd: Crowd

    @property
    def energy(self) -> float:
        """Sum of all terms [J]."""
        return float(self.strand_energy.sum() + self.crowding.sum())


class NewtonSystem:
    """`HairEnergy` of one sample of a scene, in float64 and with the body's creases rounded (`rounded_contact`).

    Attributes:
        evaluations: of the energy or its derivatives, so far.
        weight: norm of gravity's gradient over all free vertices [N].
    """

    def __init__(self, energy: HairEnergy, scene: Scene, sample: int) -> None:
        self.k_self_collision = energy.material.k_self_collision
        self.smoothing_length = energy.material.smoothing_length
        self.evaluations = 0
        self.hair = hair_arrays(energy, scene.director[sample])
        self.body = body_arrays(scene.surface, sample)
        self.rest_density: PerVertex = energy.rest.rest_density.double().numpy()
        # Where the search for each vertex's nearest face starts.
        self.places = np.zeros(self.rest_density.shape, np.int64)
        self.weight = STANDARD_GRAVITY * float(np.linalg.norm(self.hair.mass[:, 1:]))

    def point(self, positions: Vertices) -> Point:
        """All terms of the energy at vertices [m]."""
        self.evaluations += 1
        strands = np.empty(len(positions))
        strand_energies(positions, self.hair, self.body, self.places, strands)
        crowd = crowd_of(positions.reshape(-1, 3), self.hair.mass.ravel(), self.smoothing_length)
        found = np.empty(self.rest_density.size)
        found[crowd.order] = density(crowd)
        excess = found.reshape(self.rest_density.shape) - self.rest_density
        return Point(positions, strands, excess, self.k_self_collision * excess.clip(min=0) ** 3, crowd)


class QuadraticModel:
    """A quadratic model of the energy round a point.

    Far from a minimum the energy is not convex, and the model is made so; close to it the exact Hessian takes over.

    Args:
        point: with its energy.
        slack: by how much every density may rise before the step ends [kg/m^3]: hair that does not touch yet resists as
            if it did so by that much.
        repulsion: see `quaffure.energies.density_hessian.pressed`; None for the exact Hessian, without slack.

    Attributes:
        gradient: of all terms, exact, zero at the roots [N].
        is_definite: whether every strand's own part of the Hessian is positive definite, as of a convex model it is;
            `precondition` needs it.
    """

    def __init__(self, system: NewtonSystem, point: Point, slack: PerVertex, repulsion: float | None) -> None:
        system.evaluations += 1
        convex = repulsion is not None
        self.point, self._k = point, system.k_self_collision
        self._reserve: PerVertex = (point.excess + slack if convex else point.excess).clip(min=0)
        self._own = np.empty(point.positions.shape)
        blocks = (*point.positions.shape, 3)
        self._diagonal, self._coupling = np.empty(blocks), np.empty((blocks[0], blocks[1] - 1, 3, 3))
        linearize_strands(
            point.positions, system.hair, system.body, system.places, convex,
            self._own, self._diagonal, self._coupling,
        )  # fmt: skip
        slope = self._sorted(3 * self._k * point.excess.clip(min=0) ** 2)
        stiffness = self._sorted(6 * self._k * self._reserve)
        self._pairs = pressed(point.crowd, slope, stiffness, repulsion)
        self.gradient = self._own + self._unsorted(density_force(self._pairs, slope))
        self._pivots, definite = np.empty(blocks), np.empty(len(point.positions), np.bool_)
        blocks_of_all = self._diagonal + self._unsorted(density_blocks(self._pairs))
        factor_strands(blocks_of_all, self._coupling, self._pivots, definite)
        self.is_definite = bool(definite.all())

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

    def forecast(self, step: Vertices) -> "Forecast":
        """What the model says along a step."""
        product = np.empty_like(step)
        multiply_strands(self._diagonal, self._coupling, step, product)
        change = self._unsorted(density_change(self._pairs, self._sorted(step)))
        return Forecast(
            slope=(self._own * step).sum((1, 2)),
            curvature=(step * product).sum((1, 2)),
            crowd_slope=3 * self._k * (self.point.excess.clip(min=0) ** 2 * change).sum(1),
            crowd_curvature=6 * self._k * (self._reserve * change**2).sum(1),
        )

    def _sorted(self, values: np.ndarray) -> np.ndarray:
        """Values of vertices [s, n, ...] in the crowd's order."""
        return values.reshape(-1, *values.shape[2:])[self.point.crowd.order]

    def _unsorted(self, values: np.ndarray) -> np.ndarray:
        """Back from the crowd's order; vectors and blocks are zero at the roots."""
        back = np.empty_like(values)
        back[self.point.crowd.order] = values
        back = back.reshape(*self._own.shape[:2], *values.shape[1:])
        if values.ndim > 1:
            back[:, 0] = 0.0
        return back


class Forecast(NamedTuple):
    """What a model says of every strand along a step.

    Attributes:
        slope, curvature: of the strand's own energy [J].
        crowd_slope, crowd_curvature: of Eq. 11 of its vertices [J].
    """

    slope: PerStrand
    curvature: PerStrand
    crowd_slope: PerStrand
    crowd_curvature: PerStrand

    def surprise(self, start: Point, length: PerStrand, reached: Point) -> PerStrand:
        """By how much every strand costs more than foreseen after a share of the step, both parts by itself [J].

        Args:
            length: share that each strand took.
        """
        own = length * self.slope + 0.5 * length**2 * self.curvature
        crowd = length * self.crowd_slope + 0.5 * length**2 * self.crowd_curvature
        in_strand = reached.strand_energy - start.strand_energy - own
        in_crowd = (reached.crowding - start.crowding).sum(1) - crowd
        return in_strand.clip(min=0) + in_crowd.clip(min=0)
