"""Newton's method on the vertices: the reference solver, whose minimum defines `excess_energy`.

Most strands come to rest within a few steps; then a few, which slide past others or over an edge of the body, carry
nearly all of the gradient. So each round moves only the strands that matter, the rest held, at a cost in proportion;
all strands take part where the gradient is spread (`quaffure.drapers.newton_descent` has the steps themselves).
"""

import math
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Int

from quaffure.config import HairMaterial
from quaffure.drapers.draper import StoppingReport
from quaffure.drapers.lbfgs import LbfgsDraper
from quaffure.drapers.newton_descent import MOST_DAMPING, Trust, descend
from quaffure.drapers.newton_system import NewtonSystem, PerStrand, Point, Vertices
from quaffure.drapers.scene import Scene
from quaffure.drapers.stopping import stopping_report
from quaffure.drapers.xpbd import XpbdDraper, XpbdSetting
from quaffure.energies.hair_energy import HairEnergy
from quaffure.types import Positions

PATIENT = XpbdSetting(steps=200)
"""XPBD with twice the time steps: it ends lower where hair has far to swing, and in another minimum elsewhere."""
BRIEF = 100
"""Evaluations of L-BFGS, which ends lower than XPBD on some curls; what more of them would bring Newton's steps do."""
LEFT_OUT = 0.3
"""Share of the gradient's norm that the strands which are held may have."""
FEW = 0.25
"""Share of the strands up to which they are moved alone."""
SPREAD = 0.5
"""Where this share of the gradient's norm is left after some strands came to rest, it is others' now."""
FORETOLD = 0.96
"""Exactness from which all strands together are worth a step."""
_FEWEST = 20
_STEPS = 10  # of some strands before others have their turn
_ROUND = 0.1  # a round's own cost in steps of all strands


class NewtonDraper:
    """Minimizes `HairEnergy` over vertices, roots held, from the best of where XPBD, twice, and L-BFGS lead.

    Where hair presses on hair there are many minima, and no solver always finds the lowest: never to end above one of
    the others, it asks them.

    Attributes:
        tolerance: norm of the gradient at which a sample is done, over that of gravity's gradient, which is also the
            gradient of the posed groom away from the body: there nothing is bent or stretched.
        steps: at most, a sample; steps of some strands count in proportion. Fewer where none lowers the energy.
    """

    name = "newton"

    def __init__(self, material: HairMaterial | None = None, tolerance: float = 1e-4, steps: int = 100) -> None:
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
        lbfgs = LbfgsDraper(self.material, evaluations=BRIEF)
        drapers = (XpbdDraper(self.material), XpbdDraper(self.material, PATIENT), lbfgs)
        starts = torch.stack([draper.drape(scene) for draper in drapers])
        costs = torch.stack([energy.total(positions, scene.director, scene.surface) for positions in starts])
        positions = starts[costs.argmin(dim=0), torch.arange(len(scene.posed))].detach()
        evaluations, worst = 0.0, 0.0
        for sample in range(len(positions)):
            system = NewtonSystem(energy, scene, sample)
            settled, relative = self.minimize(system, positions[sample].double().numpy())
            positions[sample] = torch.from_numpy(settled)
            evaluations, worst = evaluations + system.evaluations, max(worst, relative)
        seconds = time.perf_counter() - start
        report = stopping_report(energy, scene, positions, math.ceil(evaluations / len(positions)), seconds)
        return positions, replace(report, relative_gradient=worst)

    def minimize(self, system: NewtonSystem, positions: Vertices) -> tuple[Vertices, float]:
        """Vertices [m] at or near a minimum, never higher than `positions`, and the relative norm of the gradient."""
        start = system.point(positions)
        state = _State(start, system.strand_gradient(start), Trust(np.full(positions.shape[:2], 0.05)))
        taken, together, is_tamed, energy, before = 0.0, False, False, math.inf, math.inf
        while True:
            forces = np.linalg.norm(state.own + system.crowd_gradient(state.point), axis=(1, 2)) / system.weight
            relative, has_stalled = float(np.linalg.norm(forces)), state.point.energy >= energy
            if relative <= self.tolerance or taken >= self.steps or (has_stalled and together and is_tamed):
                return state.point.positions, relative
            has_spread = relative > SPREAD * before and state.trust.exactness > FORETOLD
            strands, target = heaviest(forces), max(LEFT_OUT * relative, 0.5 * self.tolerance)
            together = len(strands) > FEW * len(forces) or has_stalled or (has_spread and not together)
            is_tamed, energy, before = state.trust.damping > MOST_DAMPING, state.point.energy, relative
            state, effort = _all_moved(system, state) if together else _some_moved(system, state, strands, target)
            taken += effort


class _State(NamedTuple):
    """Where the descent is.

    Attributes:
        own: gradient of all terms but Eq. 11 [N].
        trust: in the next model.
    """

    point: Point
    own: Vertices
    trust: Trust


def heaviest(forces: PerStrand) -> Int[np.ndarray, " k"]:
    """The fewest strands that leave at most `LEFT_OUT` of the forces' norm to the others, in rising order."""
    order = np.argsort(-forces)
    left = np.sqrt(np.cumsum(forces[order][::-1] ** 2)[::-1])
    count = int((left > LEFT_OUT * left[0]).sum())
    return np.sort(order[: max(count, _FEWEST)])


def _all_moved(system: NewtonSystem, state: _State) -> tuple[_State, float]:
    """One step of all strands, and the effort, in such steps."""
    point, trust, _ = descend(system, state.point, state.trust, 0.0, 1)
    return _State(point, system.strand_gradient(point), trust), 1.0


def _some_moved(
    system: NewtonSystem, state: _State, strands: Int[np.ndarray, " k"], target: float
) -> tuple[_State, float]:
    """Steps of some strands alone, until they are done or it takes too many, and the effort in steps of all."""
    part, (point, own, trust) = system.of_strands(strands, state.point), state
    start = part.point(point.positions[strands])
    reached, last, steps = descend(part, start, replace(trust, slack=trust.slack[strands]), target, _STEPS)
    own, slack, share = own.copy(), trust.slack.copy(), len(strands) / len(own)
    own[strands], slack[strands] = part.strand_gradient(reached), last.slack
    system.evaluations += part.evaluations * share
    moved = system.joined(point, strands, part, reached)
    return _State(moved, own, replace(last, slack=slack)), _ROUND + share * steps
