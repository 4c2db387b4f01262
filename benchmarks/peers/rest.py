"""One criterion of rest for everything that ends in a drape, and what it costs with many more strands."""

import math
from dataclasses import dataclass

import numpy as np

TOLERANCE = 1e-3
"""Mean distance of all vertices to a program's own end, from which it counts as arrived [m]."""


@dataclass(frozen=True)
class Trace:
    """States on the way to rest: of a simulation over time, or of a solver with larger and larger budgets.

    Attributes:
        cpu_seconds: [F] processor time to each state.
        states: [F,S,N,3] vertices [m]; the last is the end.
    """

    cpu_seconds: np.ndarray
    states: np.ndarray


def arrival(trace: Trace, tolerance: float = TOLERANCE) -> int:
    """Index of the first state from which on none is further than `tolerance` from the end, in the mean.

    Raises:
        ArithmeticError: the end is not finite: the program blew up.
    """
    if not np.isfinite(trace.states[-1]).all():
        raise ArithmeticError("the run blew up: its last state is not finite")
    distance = np.linalg.norm(trace.states - trace.states[-1], axis=-1).mean(axis=(1, 2))
    away = np.flatnonzero(~(distance <= tolerance))  # a state that blew up, NaN, is away
    return int(away[-1]) + 1 if len(away) else 0


def extrapolated(seconds: float, growth: float, factor: float) -> float:
    """Time for `factor` times the strands, by the power law of the growth for twice the strands."""
    return seconds * factor ** math.log2(growth)
