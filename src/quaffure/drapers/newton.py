"""Newton's method on the vertices: the reference solver, whose minimum defines `excess_energy`.

Each step solves a model of the whole energy by conjugate gradients, preconditioned by the block-tridiagonal factors of
the strands (Nocedal and Wright 2006, section 7.1). The model is convex until the gradient is small; the exact Hessian
then brings the last digits in a few steps. Edges turn along arcs, so that a long step does not
stretch them. Where single strands meet what the model did not foresee, a crease of the body or other hair, they alone
take a shorter step. No step is taken that raises the energy.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import torch

from quaffure.config import HairMaterial
from quaffure.drapers.adam import AdamDraper
from quaffure.drapers.draper import StoppingReport
from quaffure.drapers.newton_system import NewtonSystem, PerStrand, PerVertex, Point, QuadraticModel, Vertices
from quaffure.drapers.scene import Scene
from quaffure.drapers.stopping import stopping_report
from quaffure.drapers.xpbd import XpbdDraper, XpbdSetting
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.strand_newton import turn_edges
from quaffure.types import Positions

PATIENT = XpbdSetting(steps=200)
"""XPBD with twice the time steps: it ends lower where hair has far to swing, and in another minimum elsewhere."""
SUFFICIENT = 0.1
"""Decrease that a step must bring, of what its slope promises."""
TOLERABLE = 0.02
"""What one strand may cost more than foreseen, of what the whole step promises."""
SHORTER = 0.4
NEAR = 0.03
"""Relative gradient below which the exact Hessian is tried; less after every vain trial."""
_TRIALS = 12
_INNER_ITERATIONS = 150


@dataclass(frozen=True)
class _Trust:
    """What the model is told beyond derivatives; `quaffure.drapers.newton_system.QuadraticModel` explains slack and
    repulsion.

    All follows from the last step: hair that came closer resists sooner, a model that proved too stiff is softened, and
    one that foretold a step near a minimum gives way to the exact Hessian.

    Attributes:
        exact: try the exact Hessian.
        near: relative gradient below which to.
    """

    slack: PerVertex
    repulsion: float = 0.25
    exact: bool = False
    near: float = NEAR

    def after(self, relative: float, rise: PerVertex, agreement: float, trials: int) -> "_Trust":
        """The trust for the next step.

        Args:
            relative: norm of the gradient before the step, over that of gravity's.
            rise: of every density, had the whole step been taken [kg/m^3].
            agreement: change of the energy over the model's for the whole step.
            trials: steps tried.
        """
        repulsion = self.repulsion
        if agreement > 1.1 and trials == 1:
            repulsion *= 0.6
        elif not self.exact and (agreement < 0.6 or trials > 2):
            repulsion *= 1.5
        slack = np.maximum(0.5 * self.slack, 0.7 * rise.clip(min=0))
        foretold = trials == 1 and agreement > 0.25
        near = 0.3 * self.near if self.exact and not foretold else self.near
        return _Trust(slack, min(max(repulsion, 0.05), 1.0), foretold and relative < near, near)

    def model(self, system: NewtonSystem, point: Point) -> QuadraticModel:
        """The model at a point; the convex one where the exact Hessian is of no use."""
        if self.exact:
            exact = QuadraticModel(system, point, self.slack, None)
            if exact.is_definite:
                return exact
        return QuadraticModel(system, point, self.slack, self.repulsion)


class NewtonDraper:
    """Minimizes `HairEnergy` over vertices, roots held, from the best of where XPBD, twice, and Adam lead.

    Where hair presses on hair there are many minima, and no solver always finds the lowest: never to end above one of
    the others, it asks them.

    Attributes:
        tolerance: norm of the gradient at which a sample is done, over that of gravity's gradient, which is also the
            gradient of the posed groom away from the body: there nothing is bent or stretched.
        steps: at most, a sample; fewer where none lowers the energy.
    """

    name = "newton"

    def __init__(self, material: HairMaterial | None = None, tolerance: float = 1e-4, steps: int = 40) -> None:
        self.material = material or HairMaterial()
        self.tolerance, self.steps = tolerance, steps

    def drape(self, scene: Scene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped; its iterations are the evaluations of one sample.

        The relative gradient of the report is that of `tolerance`: the whole gradient, in double precision, of the
        energy with rounded creases. At a crease the exact energy has none that vanishes.
        """
        start = time.perf_counter()
        energy = HairEnergy(scene.groom, self.material)
        drapers = (XpbdDraper(self.material), XpbdDraper(self.material, PATIENT), AdamDraper(self.material))
        starts = torch.stack([draper.drape(scene) for draper in drapers])
        costs = torch.stack([energy.total(positions, scene.director, scene.surface) for positions in starts])
        positions = starts[costs.argmin(dim=0), torch.arange(len(scene.posed))].detach()
        evaluations, worst = 0, 0.0
        for sample in range(len(positions)):
            system = NewtonSystem(energy, scene, sample)
            settled, relative = self.minimize(system, positions[sample].double().numpy())
            positions[sample] = torch.from_numpy(settled)
            evaluations, worst = evaluations + system.evaluations, max(worst, relative)
        seconds = time.perf_counter() - start
        report = stopping_report(energy, scene, positions, evaluations // len(positions), seconds)
        return positions, replace(report, relative_gradient=worst)

    def minimize(self, system: NewtonSystem, positions: Vertices) -> tuple[Vertices, float]:
        """Vertices [m] at or near a minimum, never higher than `positions`, and the relative norm of the gradient."""
        trust = _Trust(np.full(positions.shape[:2], 0.05))
        model = trust.model(system, system.point(positions))
        for _ in range(self.steps):
            relative = float(np.linalg.norm(model.gradient)) / system.weight
            if relative <= self.tolerance:
                break
            step = conjugate_gradients(model, min(0.1, 0.5 * relative**0.5))
            reached, foreseen, trials, rise = _search(system, model, step)
            agreement = (reached.energy - model.point.energy) / min(foreseen, -1e-300)
            if agreement <= 0 and trust.repulsion == 1.0 and not trust.exact:
                break
            trust = trust.after(relative, rise, agreement, trials)
            model = trust.model(system, reached if agreement > 0 else model.point)
        return model.point.positions, float(np.linalg.norm(model.gradient)) / system.weight


def conjugate_gradients(model: QuadraticModel, tolerance: float) -> Vertices:
    """The model's minimum [m], to a preconditioned residual of `tolerance` relative to the gradient's."""
    residual = -model.gradient
    step, scaled = np.zeros_like(residual), model.precondition(residual)
    direction, product = scaled.copy(), float((residual * scaled).sum())
    target = tolerance**2 * product
    for _ in range(_INNER_ITERATIONS):
        image = model.product(direction)
        curvature = float((direction * image).sum())
        if curvature <= 0:
            return step
        length = product / curvature
        step += length * direction
        residual -= length * image
        scaled = model.precondition(residual)
        before, product = product, float((residual * scaled).sum())
        if product <= target:
            return step
        direction = scaled + (product / before) * direction
    return step


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
