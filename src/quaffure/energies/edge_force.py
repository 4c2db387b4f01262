"""Energy and force of one edge, Eqs. 6 and 7, as scalar functions that every kernel inlines.

The constants are float32 numbers that float64 holds exactly too: the precision is that of the arguments.
"""

import numpy as np
from numba import njit

_HALF = np.float32(0.5)


@njit(cache=True, fastmath=True, inline="always")
def stretch_shear_force(
    edge: float, director: float, inverse_rest_length: float, k_cosserat: float
) -> tuple[float, float]:
    """Eq. 6 along one axis: the derivative by the edge [N], k_c / l (e / l - d3), and the energy [J].

    Args:
        edge, director: components of the edge [m] and of its unit director along the axis.
        inverse_rest_length: 1 / l [1/m].
        k_cosserat: k_c [J].
    """
    strain = edge * inverse_rest_length - director
    return k_cosserat * inverse_rest_length * strain, _HALF * k_cosserat * strain * strain


@njit(cache=True, fastmath=True, inline="always")
def stretch_force(length: float, rest_length: float, k_stretch: float) -> tuple[float, float]:
    """Eq. 7: the derivative by the length of an edge [N], k_s (|e| - l), and the energy [J]."""
    longer = length - rest_length
    return k_stretch * longer, _HALF * k_stretch * longer * longer
