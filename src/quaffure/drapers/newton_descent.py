"""Newton steps of some or all strands: what the model is told, its minimum by conjugate gradients, the line search.

Each step solves a model of the energy by conjugate gradients, preconditioned by the block-tridiagonal factors of the
strands (Nocedal and Wright 2006, section 7.1). The model lies between a convex one and the exact one, the nearer to
that the better it foretells. Edges turn along arcs, so that a long step does not stretch them. Where single strands
meet what the model did not foresee, a crease of the body or other hair, they alone take a shorter step. No step is
taken that raises the energy.
"""

from dataclasses import dataclass

import numpy as np

from quaffure.drapers.newton_system import NewtonSystem, PerStrand, PerVertex, Point, QuadraticModel, Vertices
from quaffure.energies.strand_newton import turn_edges

SUFFICIENT = 0.1
"""Decrease that a step must bring, of what its slope promises."""
TOLERABLE = 0.02
"""What one strand may cost more than foreseen, of what the whole step promises."""
SHORTER = 0.4
LEAST_DAMPING = 1e-3
MOST_DAMPING = 10.0
"""Where a step so short still fails, none will do."""
_TRIALS = 12
_INNER_ITERATIONS = 150


@dataclass(frozen=True)
class Trust:
    """What a model is told beyond derivatives; `quaffure.drapers.newton_system.QuadraticModel` explains both.

    All follows from the last step: hair that came closer resists sooner, the exact Hessian counts for more the better
    the model foretold, and where even the convex one led too far, steps are damped.
    """

    slack: PerVertex
    exactness: float = 0.0
    damping: float = 0.0

    def after(self, relative: float, rise: PerVertex, agreement: float, trials: int, is_bent: bool) -> "Trust":
        """The trust for the next step.

        Args:
            relative: norm of the gradient before the step, over that of gravity's.
            rise: of every density, had the whole step been taken [kg/m^3].
            agreement: change of the energy over the model's for the whole step.
            trials: steps tried.
            is_bent: whether a direction of negative curvature was met.
        """
        exactness, damping = self.exactness, self.damping if trials > 2 else 0.25 * self.damping
        if trials > _TRIALS // 2:
            damping = max(4 * damping, LEAST_DAMPING) if exactness == 0 else damping
            exactness = 0.3 * exactness if exactness > 0.1 else 0.0
        elif trials > 2 or is_bent:
            exactness *= 0.7
        elif trials == 1 and agreement > 0.5:
            exactness = 1.0 - (0.3 if abs(agreement - 1.0) < 0.1 else 0.6) * (1.0 - exactness)
        slack = np.maximum(0.5 * self.slack, 0.7 * rise.clip(min=0))
        return Trust(slack, max(min(exactness, 1.0 - relative), 0.0), damping if damping >= LEAST_DAMPING else 0.0)


def descend(system: NewtonSystem, point: Point, trust: Trust, target: float, steps: int) -> tuple[Point, Trust, int]:
    """Newton steps from a point until the gradient's norm over `system.weight` is at most `target`.

    Returns the point reached, the trust for the next step there, and the number of steps.
    """
    for taken in range(steps):
        model = QuadraticModel(system, point, trust.slack, trust.exactness, trust.damping)
        relative = float(np.linalg.norm(model.gradient)) / system.weight
        if relative <= target:
            return point, trust, taken
        step, is_bent = conjugate_gradients(model, 0.1)
        reached, foreseen, trials, rise = _search(system, model, step)
        agreement = (reached.energy - point.energy) / min(foreseen, -1e-300)
        if agreement > 0:
            point = reached
        elif trust.exactness == 0 and trust.damping > MOST_DAMPING:
            return point, trust, taken + 1
        trust = trust.after(relative, rise, agreement, trials, is_bent)
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


def _search(system: NewtonSystem, model: QuadraticModel, step: Vertices) -> tuple[Point, float, int, PerVertex]:
    """Shorten a step, strand by strand where strands are to blame, until it lowers the energy enough.

    Returns where it leads, the change of energy that the model foresees for the whole step [J], the number of steps
    tried, and by how much the whole step would have raised every density [kg/m^3].
    """
    slope = float((model.gradient * step).sum())
    length: PerStrand = np.ones(len(step))
    reached = _moved(system, model, step, length)
    rise, trial = reached.excess - model.point.excess, 1
    forecast = model.forecast(step)
    while trial < _TRIALS and reached.energy - model.point.energy > SUFFICIENT * slope * float(length.mean()):
        to_blame = forecast.surprise(model.point, length, reached) > -TOLERABLE * slope * 0.5**trial
        length = np.where(to_blame if to_blame.any() and trial < _TRIALS // 2 else True, SHORTER * length, length)
        reached = _moved(system, model, step, length)
        trial += 1
    return reached, 0.5 * slope, trial, rise


def _moved(system: NewtonSystem, model: QuadraticModel, step: Vertices, length: PerStrand) -> Point:
    moved = np.empty_like(step)
    turn_edges(model.point.positions, length[:, None, None] * step, moved)
    return system.point(moved)
