"""Newton's method on the vertices: the reference solver, whose minimum defines `excess_energy`.

Most strands come to rest within a few steps; then a few, which slide past others or over an edge of the body, carry
nearly all of the gradient. So each round moves only the strands that matter, the rest held, at a cost in proportion; all
strands take part where the gradient is spread (`quaffure.drapers.newton_descent` has the steps themselves).
"""

import math
import time
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Int

from quaffure.config import HairMaterial
from quaffure.drapers.adam import AdamDraper
from quaffure.drapers.draper import StoppingReport
from quaffure.drapers.newton_descent import Trust, descend
from quaffure.drapers.newton_system import NewtonSystem, PerStrand, Point, Vertices
from quaffure.drapers.scene import Scene
from quaffure.drapers.stopping import stopping_report
from quaffure.drapers.xpbd import XpbdDraper, XpbdSetting
from quaffure.energies.hair_energy import HairEnergy
from quaffure.types import Positions

PATIENT = XpbdSetting(steps=200)
"""XPBD with twice the time steps: it ends lower where hair has far to swing, and in another minimum elsewhere."""
LEFT_OUT = 0.3
"""Share of the gradient's norm that the strands which are held may have."""
FEW = 0.25
"""Share of the strands up to which they are moved alone."""
SPREAD = 0.5
"""Where this share of the gradient's norm is left after some strands came to rest, it is others' now."""
FORETOLD = 0.9
"""Exactness from which all strands together are worth a step."""
_FEWEST = 20
_STEPS_OF_FEW = 10
_STEPS_OF_ALL = 3
_ROUND = 0.1  # a round's own cost in steps of all strands


class NewtonDraper:
    """Minimizes `HairEnergy` over vertices, roots held, from the best of where XPBD, twice, and Adam lead.

    Where hair presses on hair there are many minima, and no solver always finds the lowest: never to end above one of
    the others, it asks them.

    Attributes:
        tolerance: norm of the gradient at which a sample is done, over that of gravity's gradient, which is also the
            gradient of the posed groom away from the body: there nothing is bent or stretched.
        steps: at most, a sample; steps of some strands count in proportion. Fewer where none lowers the energy.
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
        point, trust, taken = system.point(positions), Trust(np.full(positions.shape[:2], 0.05)), 0.0
        forces, together = self._forces(system, point), False
        while True:
            relative, before = float(np.linalg.norm(forces)), point.energy
            if relative <= self.tolerance or taken >= self.steps:
                return point.positions, relative
            strands, target = heaviest(forces), max(LEFT_OUT * relative, 0.5 * self.tolerance)
            together = together or len(strands) > FEW * len(forces)
            if together:
                point, trust, steps = descend(system, point, trust, target, _STEPS_OF_ALL)
                taken += steps
            else:
                point, trust, effort = _settle(system, point, strands, trust, target)
                taken += effort
            if together and point.energy >= before:
                return point.positions, relative
            forces = self._forces(system, point)
            has_spread = trust.exactness > FORETOLD and float(np.linalg.norm(forces)) > SPREAD * relative
            together = not together and (point.energy >= before or has_spread)

    def _forces(self, system: NewtonSystem, point: Point) -> PerStrand:
        """Norm of the gradient by every strand, over that of gravity's by the whole groom."""
        forces: PerStrand = np.linalg.norm(system.gradient(point), axis=(1, 2)) / system.weight
        return forces


def heaviest(forces: PerStrand) -> Int[np.ndarray, " k"]:
    """The fewest strands that leave at most `LEFT_OUT` of the forces' norm to the others, in rising order."""
    order = np.argsort(-forces)
    left = np.sqrt(np.cumsum(forces[order][::-1] ** 2)[::-1])
    count = int((left > LEFT_OUT * left[0]).sum())
    return np.sort(order[: max(count, _FEWEST)])


def _settle(
    system: NewtonSystem, point: Point, strands: Int[np.ndarray, " k"], trust: Trust, target: float
) -> tuple[Point, Trust, float]:
    """Move some strands alone. Returns the point of all reached, the trust there, and the effort in steps of all."""
    part, share = system.of_strands(strands, point), len(strands) / len(point.positions)
    start = part.point(point.positions[strands])
    reached, last, steps = descend(part, start, Trust(trust.slack[strands], trust.exactness), target, _STEPS_OF_FEW)
    system.evaluations += part.evaluations * share
    positions, slack = point.positions.copy(), trust.slack.copy()
    positions[strands], slack[strands] = reached.positions, last.slack
    return system.point(positions), Trust(slack, last.exactness), _ROUND + share * steps
