"""Our own drapers on the peers' scene, each with larger and larger budgets."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from rest import Trace

from quaffure.baselines import PosedDraper
from quaffure.draper import Draper
from quaffure.energies.by_name import hair_terms
from quaffure.model import load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import LbfgsDraper, XpbdDraper, XpbdSetting
from quaffure.types import Positions

WARM_UP_STRANDS = 8


@dataclass(frozen=True)
class Ours:
    """A draper of ours.

    Attributes:
        budgets: steps or evaluations in rising order; empty for what knows no budget.
        draper: made with a budget, or with 0.
    """

    name: str
    energy: str
    budgets: tuple[int, ...]
    draper: Callable[[int], Draper]

    def trace(self, scene: Scene) -> tuple[Trace, float]:
        """Where every budget ends, and the processor time of the first drape of a few strands, which compiles."""
        few = Scene(scene.groom.select(torch.arange(WARM_UP_STRANDS)), scene.bodies)
        efforts = self.budgets or (0,)
        compile_seconds = timed_drape(self.draper(efforts[0]), few)[1]
        drapes, seconds = zip(*(timed_drape(self.draper(effort), scene) for effort in efforts))
        return Trace(torch.tensor(seconds).numpy(), torch.cat(drapes).numpy()), compile_seconds


def our_drapers() -> tuple[Ours, ...]:
    model = load_model()
    steps, evaluations = (12, 25, 50, 100, 200), (25, 50, 100, 300, 1000)
    return (
        Ours("posed", "none", (), lambda _: PosedDraper()),
        Ours("neural", "Quaffure", (), lambda _: model.draper),
        Ours("xpbd", "Quaffure", steps, lambda effort: XpbdDraper(setting=XpbdSetting(steps=effort))),
        Ours("lbfgs", "Quaffure", evaluations, lambda effort: LbfgsDraper(evaluations=effort)),
        Ours(
            "lbfgs, cosserat",
            "Cosserat rod",
            evaluations,
            lambda effort: LbfgsDraper(evaluations=effort, terms=hair_terms("cosserat")),
        ),
    )


def timed_drape(draper: Draper, scene: Scene) -> tuple[Positions, float]:
    """Draped vertices, and the processor time from groom and pose to them [s]."""
    # A scene of its own: the body is posed within the time.
    bodies = scene.bodies
    fresh = Scene(scene.groom, BodyBatch(bodies.body, bodies.body_pose, bodies.body_shape))
    start = time.process_time()
    draped = draper.drape(fresh).detach()
    return draped, time.process_time() - start
