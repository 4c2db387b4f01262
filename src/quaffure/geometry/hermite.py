"""Keys of an animation: between which two a time is, and cubic Hermite splines from key to key."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int


class KeyIntervals(NamedTuple):
    """Where some times are among keys.

    Attributes:
        before, after: indices of the keys around each time; the same key before the first one and after the last.
        seconds: from one to the other [s].
        share: of these seconds that have passed, 0 to 1.
    """

    before: Int[np.ndarray, " f"]
    after: Int[np.ndarray, " f"]
    seconds: Float[np.ndarray, " f"]
    share: Float[np.ndarray, " f"]


def key_intervals(
    keys: Float[np.ndarray, " k"], times: Float[np.ndarray, " f"], side: Literal["left", "right"] = "right"
) -> KeyIntervals:
    """Where times are among keys.

    Args:
        keys: at least one [s], not decreasing.
        times: [s].
        side: the interval of a time at a key: the one that begins there (`right`) or the one that ends there (`left`).
    """
    last = len(keys) - 1
    before = np.clip(np.searchsorted(keys, times, side=side) - 1, 0, last)
    after = np.minimum(before + 1, last)
    seconds = keys[after] - keys[before]
    share = np.divide(times - keys[before], seconds, out=np.zeros_like(times), where=seconds > 0).clip(0, 1)
    return KeyIntervals(before, after, seconds, share)


def hermite(
    share: Float[np.ndarray, "*#f"],
    start: Float[np.ndarray, "*#f"],
    end: Float[np.ndarray, "*#f"],
    leaving: Float[np.ndarray, "*#f"],
    arriving: Float[np.ndarray, "*#f"],
) -> Float[np.ndarray, "*f"]:
    """Cubic Hermite spline between two values (glTF 2.0, appendix C).

    Args:
        share: of the interval that has passed, 0 to 1.
        start, end: the values.
        leaving, arriving: slopes at the first and the second value, times the length of the interval.
    """
    square, cube = share**2, share**3
    return (
        (2 * cube - 3 * square + 1) * start
        + (cube - 2 * square + share) * leaving
        + (3 * square - 2 * cube) * end
        + (cube - square) * arriving
    )
