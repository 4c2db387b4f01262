"""Newton's method on the vertices: the reference solver, whose minimum defines `excess_energy`.

Most strands come to rest within a few steps; then a few, which slide past others or over an edge of the body, carry
nearly all of the gradient. So each round moves only the strands that matter, the rest held, at a cost in proportion;
all strands take part where the gradient is spread (`quaffure.solvers.newton.newton_descent` has the steps themselves).
"""

import math
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Int

from quaffure.config import HairMaterial
from quaffure.draper import StoppingReport
from quaffure.energies.energy_term import Terms
from quaffure.energies.gravity import GRAVITY, Gravity
from quaffure.energies.hair_energy import HairEnergy
from quaffure.errors import InputError
from quaffure.geometry.cell_list import check_finite
from quaffure.scene import HairScene, PosedScene
from quaffure.solvers.lbfgs import LbfgsDraper
from quaffure.solvers.newton.newton_descent import MOST_DAMPING, TrustRegionState, descend
from quaffure.solvers.newton.newton_system import NewtonSystem, PerStrand, Point, Vertices
from quaffure.solvers.stopping import stopping_report
from quaffure.solvers.supported_terms import refuse_other_terms
from quaffure.solvers.xpbd import XpbdDraper, XpbdSetting
from quaffure.types import Float, Positions, Tensor

PATIENT = XpbdSetting(steps=200)
"""XPBD with twice the time steps: it ends lower where hair has far to swing, and in another minimum elsewhere."""
LBFGS_EVALUATIONS = 100
"""Evaluations of L-BFGS, which ends lower than XPBD on some curls; what 300 would bring, Newton's steps do sooner."""
HELD_SHARE = 0.3
"""Share of the gradient's norm that the strands which are held may have."""
ACTIVE_SHARE = 0.25
"""Share of the strands up to which they are moved alone."""
REMAINING_SHARE = 0.5
"""Where a round of some strands leaves more of the gradient's norm, it is others' now."""
EXACT_ENOUGH = 0.96
"""Exactness from which all strands together are worth a step where the gradient has spread."""
FIRST_SLACK = 0.05
"""How far the first model lets densities rise [kg/m^3]; the first step shows more exactly."""
_FEWEST = 20
_STEPS = 10  # of some strands before others are moved
_ROUND = 0.1  # a round's own cost in steps of all strands


class NewtonDraper:
    """Minimizes `HairEnergy` over vertices, roots held, from the best of the drapes of XPBD, twice, and L-BFGS.

    Where hair presses on hair there are many minima, and no solver always finds the lowest. The drape is never above
    one of the three starts, so never above that of `XpbdDraper` with its default setting. The defaults of
    `LbfgsDraper`, with three times as many evaluations, and of `AdamDraper` are no starts and might end lower.

    Attributes:
        tolerance: norm of the gradient at which a sample is done, over that of gravity's gradient, which is also the
            gradient of the posed groom away from the body: there nothing is bent or stretched.
        steps: at most, a sample; steps of some strands count in proportion. Fewer where none lowers the energy.
    """

    name = "newton"

    def __init__(
        self,
        material: HairMaterial | None = None,
        tolerance: float = 1e-4,
        steps: int = 100,
        terms: Terms | None = None,
    ) -> None:
        """
        Raises:
            InputError: terms other than Eqs. 6, 7, 9, 10 and 11, whose second derivatives it has, or another gravity.
        """
        refuse_other_terms(self.name, terms)
        accelerations = {term.acceleration for term in terms or () if isinstance(term, Gravity)}
        if accelerations - {GRAVITY}:
            raise InputError(f"solver {self.name}", f"gravity {GRAVITY} alone", f"{accelerations.pop()}")
        self.material = material or HairMaterial()
        self.tolerance, self.steps = tolerance, steps

    def drape(self, scene: HairScene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: HairScene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped. Every sample is solved by itself.

        The relative gradient of the report is that of `tolerance`: the whole gradient of the energy with rounded
        concave edges, in double precision, before the drape is cast to float32, which moves vertices by up to 0.1 um
        (`quaffure.solvers.stopping` says what that does to the gradient). Its energy is the exact one of the drape as
        returned. Its iterations are Newton's evaluations of one sample, without those of the three starts; its seconds
        are those of the starts too.

        Raises:
            ValueError: a posed vertex is not finite.
        """
        start = time.perf_counter()
        check_finite(scene.posed)
        energy = HairEnergy(scene.groom, self.material)
        positions = torch.empty_like(scene.posed)
        evaluations, worst = 0.0, 0.0
        for index in range(len(positions)):
            sample = scene.sample(index)
            system = NewtonSystem(energy, sample, 0)
            positions[index], relative = self._settled(energy, sample, system)
            evaluations, worst = evaluations + system.evaluations, max(worst, relative)
        seconds = time.perf_counter() - start
        report = stopping_report(energy, scene, positions, math.ceil(evaluations / len(positions)), seconds)
        return positions, replace(report, relative_gradient=worst)

    def _settled(
        self, energy: HairEnergy, sample: PosedScene, system: NewtonSystem
    ) -> tuple[Float[Tensor, "s n 3"], float]:
        """Vertices of a single sample [m], and the relative norm of the gradient.

        Newton lowers the energy with rounded concave edges. Where the exact one has risen meanwhile, the start is kept.
        """
        lbfgs = LbfgsDraper(self.material, evaluations=LBFGS_EVALUATIONS)
        drapers = (XpbdDraper(self.material), XpbdDraper(self.material, PATIENT), lbfgs)
        starts = [draper.drape(sample).detach() for draper in drapers]
        costs = [float(energy.total(x, sample)) for x in starts]
        start = starts[int(np.argmin(costs))]
        settled, relative = self.minimize(system, start[0].double().numpy())
        drape = torch.from_numpy(settled).to(start.dtype)
        if float(energy.total(drape[None], sample)) <= min(costs):
            return drape, relative
        return start[0], float(np.linalg.norm(_forces(system, system.point(start[0].double().numpy()))))

    def minimize(self, system: NewtonSystem, positions: Vertices) -> tuple[Vertices, float]:
        """Vertices [m] at or near a minimum of the system's energy, and the relative norm of its gradient there.

        That energy is never higher than at `positions`.

        Raises:
            ValueError: one of the positions is not finite.
        """
        start = system.point(positions)
        state = _State(
            start, system.strand_gradient(start), TrustRegionState(np.full(positions.shape[:2], FIRST_SLACK))
        )
        taken, together, is_tamed, energy, before = 0.0, False, False, math.inf, math.inf
        while True:
            forces = _forces(system, state.point, state.own)
            relative, has_stalled = float(np.linalg.norm(forces)), state.point.energy >= energy
            if relative <= self.tolerance or taken >= self.steps or (has_stalled and together and is_tamed):
                return state.point.positions, relative
            has_spread = relative > REMAINING_SHARE * before and state.trust.exactness > EXACT_ENOUGH
            # To half the tolerance at most: the residual of the strands that are held comes on top.
            strands, target = heaviest(forces), max(HELD_SHARE * relative, 0.5 * self.tolerance)
            were_together = together
            together = len(strands) > ACTIVE_SHARE * len(forces) or has_stalled or (has_spread and not together)
            if together and not were_together:
                # What damping some strands needed does not apply to all.
                state = state._replace(trust=replace(state.trust, damping=0.0))
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
    trust: TrustRegionState


def _forces(system: NewtonSystem, point: Point, own: Vertices | None = None) -> PerStrand:
    """Norm of the gradient by every strand at a point of all, over that of gravity's by all.

    Args:
        own: gradient of all terms but Eq. 11, where it is known [N].
    """
    own = system.strand_gradient(point) if own is None else own
    return np.linalg.norm(own + system.density_energy_gradient(point), axis=(1, 2)) / system.weight


def heaviest(forces: PerStrand) -> Int[np.ndarray, " k"]:
    """The fewest strands that leave at most `HELD_SHARE` of the forces' norm to the others, in rising order."""
    order = np.argsort(-forces)
    left = np.sqrt(np.cumsum(forces[order][::-1] ** 2)[::-1])
    count = int((left > HELD_SHARE * left[0]).sum())
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
