"""One groom in one pose, whose strands are moved to rest by Newton's method, each by itself.

A pass minimizes the quadratic model of every strand (`quaffure.solvers.strand_recursion`) and shortens the step of each
until its own energy falls, that of the model of its surroundings included. Hair on hair, density and cohesion, comes
from the last positions: its force, and on the diagonal a stiffness that lets no vertex go far before the force is
computed anew.
"""

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.force_limit import MAX_FORCE
from quaffure.energies.fused_density import self_collision_and_gradient
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.rod_term import PosedRod, Rod
from quaffure.geometry.cell_list import check_finite
from quaffure.geometry.polyline import directors
from quaffure.scene import HairScene
from quaffure.solvers.restoring_goals import RestoringGoals
from quaffure.solvers.step_control import StepControl, StepHistory
from quaffure.solvers.strand_kernels import (
    DensityModel,
    Evaluation,
    StrandArrays,
    evaluate_strands,
    largest_displacements,
    limit_rotations,
    model_surroundings,
    resolve_strands,
    rotate_edges,
    take_strands,
)
from quaffure.solvers.strand_recursion import StrandModel, newton_rotations
from quaffure.solvers.stray_strands import APART, BESIDE, nearest_of, stands_apart
from quaffure.types import Float, Positions, Tensor

FREE_TURN = 1.5
"""Largest rotation of an edge in a pass without contact [rad]."""


class _State(NamedTuple):
    """A shape of the hair and the energy of all terms [J]."""

    energy: float
    direction: np.ndarray


class StrandDescent:
    """The strands of one groom in one pose on their way to rest.

    Attributes:
        direction: unit direction of every edge [strand edge 3].
        passes: done so far.
        moved: largest displacement of a vertex of each strand in the last pass [m].
        history: of passes with all terms.
    """

    def __init__(
        self,
        energy: HairEnergy,
        scene: HairScene,
        control: StepControl | None = None,
        direction: Float[Tensor, "s e 3"] | None = None,
    ) -> None:
        """
        Args:
            direction: unit directions of the edges to start from; those of the posed groom where none are given.
            energy: of the rod, Eqs. 7, 9, 10 and 11, and of tails; lengths are kept, so that Eq. 7 stays 0.
            scene: of one sample.

        Raises:
            ValueError: a posed vertex or a direction is not finite.
        """
        check_finite(scene.posed)
        if direction is not None:
            check_finite(direction)
        self._energy, self._scene, self._control = energy, scene, control or StepControl()
        self._cohesion = energy.of_kind(Cohesion)
        rest = energy.rest
        posed_rod = _rod_of(energy, scene)
        self._rod = posed_rod.arrays
        self._held = self._rod.goal_weight
        self._is_free = (self._held == 0).all(axis=1)
        self._body = scene.surface.sample_arrays(0)
        rotation, mass = _float32(posed_rod.rotation[0]), _float32(rest.mass)
        acceleration = np.array(energy.acceleration, np.float32)
        root, length = _float32(scene.posed[0, :, 0]), _float32(rest.rest_length)
        self._hair = StrandArrays(rotation, root, length, mass, acceleration, _float32(rest.collision_margin))
        self._root_direction = np.einsum("sij,sj->si", rotation, self._rod.root_frame[:, 0]).astype(np.float32)
        self._k_body_collision = np.float32(energy.material.k_body_collision)
        strands, vertices = mass.shape
        self._strands = np.arange(strands)
        self._unlimited, self._undamped = np.full(strands, 1e6, np.float32), np.zeros(strands, np.float32)
        # The unit of forces between strands, which push apart without gravity too: no less than their weight on earth.
        self._own_weight = max(STANDARD_GRAVITY, math.hypot(*energy.acceleration)) * mass
        # Where strands cross, Eq. 11 has forces of 1e7 weights, beside which float64 keeps nothing of the rod.
        self._most_force = MAX_FORCE * self._own_weight.sum(axis=1)
        self._now, self._trial = _evaluation(strands, vertices), _evaluation(strands, vertices)
        self._around = DensityModel(
            np.zeros((strands, vertices, 3), np.float32),
            np.zeros((strands, vertices), np.float32),
            np.zeros((strands, vertices, 3), np.float32),
        )
        self.direction = _float32(directors(scene.posed[0]) if direction is None else direction).copy()
        self.passes, self.moved = 0, np.zeros(strands, np.float32)
        self._lowest: _State | None = None  # of passes with all terms since the start
        # Stiffness of contact that `_now` was evaluated with; None where the directions have changed since.
        self._k_of_now: np.float32 | None = None
        self._start: np.ndarray | None = None
        self.history = StepHistory(strands, self._control.oscillation)

    @property
    def positions(self) -> Positions:
        """Vertices of the current directions, a batch of one [m]."""
        self._evaluate(self._k_body_collision)
        return torch.from_numpy(self._now.positions.copy())[None]

    def run_free(self, passes: int) -> None:
        """Passes without contact and without density; tails cohere."""
        self._forget()
        for _ in range(passes):
            self._surround_by_tails()
            self._move(np.float32(0.0), FREE_TURN, backtracks=0)

    def resolve_contact(self, share: float) -> None:
        """Push vertices that are within `share` of their margins out of the body, from root to tip; the new start."""
        resolve_strands(self.direction, self._hair, self._held, self._body, np.float32(share))
        self._forget()

    def run_with_contact(self, passes: int) -> None:
        """Passes with contact and without density; tails cohere."""
        self._forget()
        for _ in range(passes):
            self._surround_by_tails()
            self._move(self._k_body_collision, self._control.most_turn, self._control.backtracks)

    def run(self, passes: int) -> None:
        """Passes with all terms; the energy may rise."""
        for _ in range(passes):
            total, gradient = self._with_other_hair()
            self._remember_lowest(total)
            self._rotate_among_others(self.history.shortened(self._rotations_among_others(gradient, self._unlimited)))

    def settle(self, passes: int) -> None:
        """Passes with all terms; ends where the energy of all hair was lowest, the start included."""
        self.run(passes)
        total = self._with_other_hair()[0]
        self._remember_lowest(total)
        if self._lowest is not None and self._lowest.energy < total:
            self.direction[:] = self._lowest.direction
            self._k_of_now = None
            self.history.forget()

    def run_limited(self, passes: int, pass_displacement: float, total_displacement: float) -> None:
        """Passes with all terms, in each of which no vertex moves by more than `pass_displacement` [m], and in all
        since the start by more than `total_displacement` [m], both to first order. The energy may rise: hair that
        follows a head is on its way."""
        for _ in range(passes):
            gradient = self._with_other_hair()[1]
            if self._start is None:
                self._start = self._now.positions.copy()
            gone = largest_displacements(self._now.positions, self._start)
            limit = np.clip(total_displacement - gone, 0.0, pass_displacement)
            self._rotate_among_others(self._rotations_among_others(gradient, limit))

    def restore(self, goals: RestoringGoals) -> None:
        """Draw strands that nothing holds back to their place around the head, in the passes that follow."""
        self._evaluate(self._k_body_collision)
        posed = self._scene.posed[0]
        displaced, on_head = goals.displaced(self._now.positions, posed.numpy())
        strands = np.flatnonzero((displaced > 0) & self._is_free)
        if not len(strands):
            return
        self._evaluate_at(_float32(directors(posed)), strands, self._k_body_collision, self._trial)
        m_g_l = (self._own_weight.sum(axis=1) * self._hair.length.sum(axis=1))[strands]
        excess = (self._trial.energy[strands, 0] - self._now.energy[strands, 0]) / m_g_l
        weight = self._held.copy()
        weight[strands] = m_g_l[:, None] * goals.weights(displaced[strands], on_head[strands], excess)
        self._rod = self._rod._replace(goal_weight=weight)
        self._evaluate_at(self.direction, strands, self._k_body_collision, self._now)

    def take_lower(self, other: "StrandDescent") -> None:
        """Take the strands that have less energy of their own in another descent of the same hair; the new start.

        Of those that something holds, all or none: tails stay whole.
        """
        for descent in (self, other):
            descent._evaluate(self._k_body_collision)
        saved, held, of_tails = self._now.energy[:, 0] - other._now.energy[:, 0], ~self._is_free, 0.0
        if self._cohesion.terms:
            of_tails = self._cohesion_and_gradient()[0] - other._cohesion_and_gradient()[0]
        saved[held] = saved[held].sum() + of_tails
        self.direction[saved > 0] = other.direction[saved > 0]
        self.passes = max(self.passes, other.passes)
        self._forget()

    def rejoin_strays(self) -> int:
        """Give strands that stand apart, but did not where they were posed, the directions of the strand rooted
        nearest to them; the new start. Those that something holds stay.

        Returns:
            How many strands took other directions.
        """
        self._evaluate(self._k_body_collision)
        is_stray = self._may_stray & stands_apart(self._now.positions, APART)
        strays, others = np.flatnonzero(is_stray), np.flatnonzero(self._may_stray & ~is_stray)
        if not len(strays) or not len(others):
            return 0
        self.direction[strays] = self.direction[nearest_of(self._hair.root, strays, others)]
        self._forget()
        return len(strays)

    @property
    def has_goals(self) -> bool:
        """Whether a tie, a clip or gel holds some edges."""
        return not self._is_free.all()

    @property
    def own_energy(self) -> float:
        """Energy without hair against hair, which adds to it, at the current directions [J]."""
        self._evaluate(self._k_body_collision)
        return float(self._now.energy[:, 0].sum())

    @property
    def lowest_energy(self) -> float:
        """Lowest energy of all terms that a pass since the start began with [J], after `settle` that of its end;
        infinite before the first pass."""
        return math.inf if self._lowest is None else self._lowest.energy

    @cached_property
    def _may_stray(self) -> np.ndarray:
        return self._is_free & ~stands_apart(_float32(self._scene.posed[0]), BESIDE)

    def _forget(self) -> None:
        """Take the directions of now for the start."""
        self._lowest = self._k_of_now = self._start = None
        self.history.forget()

    def _remember_lowest(self, total: float) -> None:
        """Keep the directions of now, where the energy of all hair has not been as low since the start [J]."""
        if total < self.lowest_energy:
            self._lowest = _State(total, self.direction.copy())

    def _evaluate(self, k_body_collision: np.float32) -> None:
        """Bring `_now` up to date, where it is not."""
        if self._k_of_now != k_body_collision:
            self._evaluate_at(self.direction, self._strands, k_body_collision, self._now)
            self._k_of_now = k_body_collision

    def _evaluate_at(
        self, direction: np.ndarray, strands: np.ndarray, k_body_collision: np.float32, found: Evaluation
    ) -> None:
        """Fill the rows of some strands, whose edges have these directions."""
        hair = self._hair, self._rod, self._around, self._body
        evaluate_strands(direction, strands, *hair, k_body_collision, found)

    def _rotations_among_others(self, gradient: np.ndarray, most_move: np.ndarray) -> np.ndarray:
        """Newton's step with all terms.

        Args:
            gradient: of the terms between strands at the positions of now [N].
            most_move: of a vertex of every strand, to first order [m].
        """
        self._model_surroundings(gradient, self.history.damping)
        return self._rotations(self._k_body_collision, self._control.most_turn, most_move)

    def _rotate_among_others(self, rotation: np.ndarray) -> None:
        """Take the step, and damp strands that it moves back."""
        before = self._now.positions.copy()
        self._rotate(rotation, self._k_body_collision, self._control.backtracks)
        self.history.record(self._now.positions - before)

    def _with_other_hair(self) -> tuple[float, np.ndarray]:
        """Energy of all terms [J], and the gradient of those between strands."""
        self._evaluate(self._k_body_collision)
        positions = torch.from_numpy(self._now.positions)
        density_energy, of_density = self_collision_and_gradient(positions, self._energy.rest, self._energy.material)
        energy, gradient = self.own_energy + density_energy, of_density.numpy()
        if self._cohesion.terms:
            cohesion_energy, of_cohesion = self._cohesion_and_gradient()
            energy, gradient = energy + cohesion_energy, gradient + of_cohesion
        return energy, gradient

    def _surround_by_tails(self) -> None:
        """Each strand is held by the rest of its tail alone, and free hair by nothing."""
        if self._cohesion.terms:
            self._evaluate(np.float32(0.0) if self._k_of_now is None else self._k_of_now)
            self._model_surroundings(self._cohesion_and_gradient()[1], self._undamped)
        else:
            self._around.gradient[:], self._around.stiffness[:] = 0.0, 0.0

    def _cohesion_and_gradient(self) -> tuple[float, np.ndarray]:
        """Energy of the cohesion of tails at the positions of now [J], and its gradient."""
        hair = torch.from_numpy(self._now.positions)[None].requires_grad_()
        energy = self._cohesion.total(hair, self._scene)
        return float(energy.detach()), torch.autograd.grad(energy, hair)[0][0].numpy()

    def _model_surroundings(self, gradient: np.ndarray, damping: np.ndarray) -> None:
        control = self._control
        weight, yielding = np.float32(control.oscillation.weight_share) * self._own_weight, control.yield_distance
        positions, around = self._now.positions, self._around
        model_surroundings(gradient, self._most_force, damping, weight, np.float32(yielding), positions, around)

    def _move(self, k_body_collision: np.float32, most_turn: float, backtracks: int) -> None:
        """One pass, see `_rotate`."""
        self._rotate(self._rotations(k_body_collision, most_turn, self._unlimited), k_body_collision, backtracks)

    def _rotations(self, k_body_collision: np.float32, most_turn: float, most_move: np.ndarray) -> np.ndarray:
        """Newton's step: rotations of all edges, limited."""
        self._evaluate(k_body_collision)
        rotation = np.empty_like(self.direction)
        newton_rotations(self._model(), k_body_collision, self._strands, rotation)
        limit_rotations(self.direction, self._hair.length, self._strands, np.float32(most_turn), most_move, rotation)
        return rotation

    def _rotate(self, rotation: np.ndarray, k_body_collision: np.float32, backtracks: int) -> None:
        """Take the step, shortened strand by strand until its energy and that of the model of its surroundings fall;
        without `backtracks` whole, whatever it does to them."""
        self.moved[:] = 0.0
        trial, pending, step = np.empty_like(self.direction), self._strands, 1.0
        for _ in range(max(backtracks, 1)):
            rotate_edges(self.direction, rotation, np.float32(step), pending, trial)
            self._evaluate_at(trial, pending, k_body_collision, self._trial)
            has_fallen = self._trial.energy[pending].sum(axis=1) < self._now.energy[pending, 0]
            taken = pending[has_fallen] if backtracks else pending
            take_strands(taken, trial, self._trial, self.direction, self._now, self.moved)
            pending = pending[~has_fallen] if backtracks else pending[:0]
            if not len(pending):
                break
            step *= self._control.shortening
        self.passes += 1

    def _model(self) -> StrandModel:
        return StrandModel(
            self.direction,
            self._root_direction,
            self._hair.length,
            self._rod.bending,
            self._rod.twisting,
            self._rod.goal_weight,
            self._now.gradient,
            self._now.contact,
            self._around.gradient,
            self._around.stiffness,
        )


def _rod_of(energy: HairEnergy, scene: HairScene) -> PosedRod:
    (rod,) = (term for term in energy.terms if type(term) is Rod)
    return rod.prepare(energy.rest, scene)


def _float32(values: Tensor) -> np.ndarray:
    return np.ascontiguousarray(values.detach().numpy(), np.float32)


def _evaluation(strands: int, vertices: int) -> Evaluation:
    return Evaluation(
        np.zeros((strands, vertices, 3), np.float32),
        np.zeros((strands, 2)),
        np.zeros((strands, vertices, 3), np.float32),
        np.zeros((strands, vertices, 4), np.float32),
    )
