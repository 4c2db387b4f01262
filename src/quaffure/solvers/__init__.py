"""Drapers that minimise the energy, one pose at a time."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.solvers.adam import AdamDraper, AdamPositionsDraper
    from quaffure.solvers.by_name import SOLVERS, DesignSolver, solver
    from quaffure.solvers.coherent_clip import CoherentDraper, CoherentSetting
    from quaffure.solvers.descent import Descent, DescentDraper
    from quaffure.solvers.lbfgs import LbfgsDraper, LbfgsPositionsDraper
    from quaffure.solvers.restoring_goals import RestoringGoals
    from quaffure.solvers.stopping import energy_and_gradient
    from quaffure.solvers.strand_descent import StrandDescent
    from quaffure.solvers.strand_newton import (
        NEAR_REST,
        SettledDraper,
        StrandNewtonDraper,
        StrandNewtonSetting,
        with_settling,
    )
    from quaffure.solvers.xpbd import XpbdDraper, XpbdSetting

__all__, __getattr__, __dir__ = lazy_exports(__name__)
