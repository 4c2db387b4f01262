"""Newton steps of some or all strands: the model and its state, its minimum by conjugate gradients, the line search.

Each step solves a model of the energy by conjugate gradients, preconditioned by the block-tridiagonal factors of the
strands (Nocedal and Wright 2006, section 7.1). The model lies between a convex one and the exact one, the nearer to
that the better it predicts. Edges turn along arcs, so that a long step does not stretch them. Where single strands
meet what the model did not predict, a concave edge of the body or other hair, they alone take a shorter step. No step
is taken that raises the energy.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quaffure.solvers.newton.newton_system import NewtonSystem, PerStrand, PerVertex, Point, QuadraticModel, Vertices
from quaffure.solvers.newton.strand_newton import turn_edges

SUFFICIENT = 0.1
"""Decrease that a step must bring, of what its slope predicts."""
TOLERABLE = 0.02
"""What one strand may cost more than predicted, of the decrease that the whole step predicts."""
SHORTER = 0.4
PREDICTED, WELL_PREDICTED = 0.5, 0.1
"""Agreement of energy and model from which the next model is more exact, and how near to 1 makes it much more so."""
LEAST_DAMPING, MOST_DAMPING = 1e-3, 10.0
"""Less than the first changes nothing; where a step as short as the second makes it still fails, none will do."""
_TRIALS = 12
_EASY_TRIALS = 2  # as many are no reason to make a model more convex
_INNER_ITERATIONS = 150


class Step(NamedTuple):
    """A step that was tried, and how the model did.

    Attributes:
        reached: where it leads; not always lower.
        trials: lengths tried.
        rise: of every density, had the whole step been taken [kg/m^3].
        has_negative_curvature: whether the model has a direction of negative curvature.
        agreement: change of the energy over the model's (rho of Nocedal and Wright 2006, eq. 4.4). 0, for nothing is
            known, where the step was shortened or is no minimum of the model.
    """

    reached: Point
    trials: int
    rise: PerVertex
    has_negative_curvature: bool
    agreement: float


@dataclass(frozen=True)
class TrustRegionState:
    """What a model depends on beyond derivatives; see `quaffure.solvers.newton.newton_system.QuadraticModel`.

    All follows from the last step: hair that came closer resists sooner, the exact Hessian counts for more the better
    the model predicted, and where even the convex one led too far, steps are damped. The agreement of energy and model
    determines them as it does the radius of a trust region (Nocedal and Wright 2006, algorithm 4.1); damping is that of
    Levenberg and Marquardt (ibid., section 10.3). How much each changes at a time was chosen by trial on whole grooms.
    """

    slack: PerVertex
    exactness: float = 0.0
    damping: float = 0.0

    def after(self, relative: float, step: Step) -> "TrustRegionState":
        """The state for the next step.

        Args:
            relative: norm of the gradient before the step, over that of gravity's. Far from rest the exact Hessian
                is of no use, however well a step went: the exactness is at most 1 less this.
        """
        # Half: a strand that stopped rising may rise again. Less than the whole rise: others give way too.
        slack = np.maximum(0.5 * self.slack, 0.7 * step.rise.clip(min=0))
        exactness = max(min(self._exactness_after(step), 1.0 - relative), 0.0)
        damping = self._damping_after(step)
        return TrustRegionState(slack, exactness, damping if damping >= LEAST_DAMPING else 0.0)

    def _exactness_after(self, step: Step) -> float:
        if step.trials > _TRIALS // 2:
            return 0.3 * self.exactness if self.exactness > 0.1 else 0.0
        if step.trials > _EASY_TRIALS or step.has_negative_curvature:
            return 0.7 * self.exactness
        if step.agreement <= PREDICTED:
            return self.exactness
        return 1.0 - (0.3 if abs(step.agreement - 1.0) < WELL_PREDICTED else 0.6) * (1.0 - self.exactness)

    def _damping_after(self, step: Step) -> float:
        """Raised where the convex model, which cannot be made any safer, led too far; lowered after easy steps."""
        if step.trials > _TRIALS // 2 and self.exactness == 0:
            return max(4 * self.damping, LEAST_DAMPING)
        return self.damping if step.trials > _EASY_TRIALS else 0.25 * self.damping


def descend(
    system: NewtonSystem, point: Point, trust: TrustRegionState, target: float, steps: int
) -> tuple[Point, TrustRegionState, int]:
    """Newton steps from a point until the gradient's norm over `system.weight` is at most `target`.

    Returns the point reached, the state for the next step there, and the number of steps.
    """
    for taken in range(steps):
        model = QuadraticModel(system, point, trust.slack, trust.exactness, trust.damping)
        relative = float(np.linalg.norm(model.gradient)) / system.weight
        if relative <= target:
            return point, trust, taken
        step = line_search(system, model, *conjugate_gradients(model, 0.1))
        if step.reached.energy < point.energy:
            point = step.reached
        elif trust.exactness == 0 and trust.damping > MOST_DAMPING:
            return point, trust, taken + 1
        trust = trust.after(relative, step)
    return point, trust, steps


def conjugate_gradients(model: QuadraticModel, tolerance: float) -> tuple[Vertices, bool]:
    """The model's minimum [m], to a preconditioned residual of `tolerance` relative to the gradient's.

    Where the model has none, downhill along a direction of negative curvature as far as the preconditioner, which is
    definite, says (Nocedal and Wright 2006, algorithm 7.2), and True.
    """
    residual = -model.gradient
    step, scaled = np.zeros_like(residual), model.precondition(residual)
    direction, product = scaled.copy(), float((residual * scaled).sum())
    target, norm = tolerance**2 * product, product
    for _ in range(_INNER_ITERATIONS):
        image = model.product(direction)
        curvature = float((direction * image).sum())
        if curvature <= 0:
            return step + (product / norm) * direction, True
        length = product / curvature
        step += length * direction
        residual -= length * image
        scaled = model.precondition(residual)
        before, product = product, float((residual * scaled).sum())
        if product <= target:
            break
        growth = product / before
        direction, norm = scaled + growth * direction, product + growth**2 * norm
    return step, False


def line_search(system: NewtonSystem, model: QuadraticModel, direction: Vertices, has_negative_curvature: bool) -> Step:
    """Shorten a step, strand by strand where the model fails, until it lowers the energy enough.

    Strands may run uphill within a step that leads downhill, so that the step with others shortened need not. Where
    single strands are not soon enough, all are shortened alike, from their full lengths if need be.

    Args:
        direction: the step [m], downhill.
        has_negative_curvature: see `Step`.
    """
    slope: PerStrand = (model.gradient * direction).sum((1, 2))
    expected, before = float(slope.sum()), model.point
    length = np.ones(len(direction))
    reached, trials = _moved(system, model, direction, length), 1
    rise, predicted = reached.excess - before.excess, model.predicted(direction)
    while trials < _TRIALS and not _suffices(reached.energy - before.energy, float((length * slope).sum())):
        model_error = predicted.model_error(before, length, reached)
        at_fault = model_error > -TOLERABLE * expected * 0.5**trials
        if trials < _TRIALS // 2 and at_fault.any():
            length = np.where(at_fault, SHORTER * length, length)
        elif (length * slope).sum() < 0:
            length = SHORTER * length
        else:
            length = np.full(len(direction), SHORTER**trials)
        reached, trials = _moved(system, model, direction, length), trials + 1
    # At a minimum along the step, which conjugate gradients find, the model has fallen by half of the slope.
    is_minimum = trials == 1 and not has_negative_curvature
    agreement = (reached.energy - before.energy) / (0.5 * expected) if is_minimum else 0.0
    return Step(reached, trials, rise, has_negative_curvature, agreement)


def _suffices(change: float, expected: float) -> bool:
    """The condition of Armijo (Nocedal and Wright 2006, eq. 3.4), and no rise, whatever the slope."""
    return change <= SUFFICIENT * expected and change < 0


def _moved(system: NewtonSystem, model: QuadraticModel, step: Vertices, length: PerStrand) -> Point:
    moved = np.empty_like(step)
    turn_edges(model.point.positions, length[:, None, None] * step, moved)
    return system.point(moved)
