"""Energy and force of contact with the body, Eq. 10, as a scalar function that every kernel inlines."""

import numpy as np
from numba import njit

_ZERO, _THREE = np.float32(0.0), np.float32(3.0)


@njit(cache=True, fastmath=True, inline="always")
def contact_force(distance: float, margin: float, k_body_collision: float) -> tuple[float, float]:
    """Eq. 10: the derivative by the signed distance [N], -3 k_bc (D - d)^2, and the energy [J], 0 from the margin on.

    Args:
        distance, margin: d and D [m].
        k_body_collision: k_bc [J/m^3].
    """
    short = max(margin - distance, _ZERO)
    return -(_THREE * k_body_collision * short * short), k_body_collision * short * short * short
