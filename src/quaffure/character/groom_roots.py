"""Roots of a groom that was made on a character: in its scene, or in axes and a unit that a format has instead."""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Float

from quaffure.character.collision_surface import Triangles, closest_on
from quaffure.errors import InputError

UNITS = (1.0, 0.01, 100.0, 0.001, 1000.0)
"""Units of the character's file in one of the groom's."""
TURNS = {
    "the axes of the character": np.eye(3),
    "z up where the character has y up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "y up where the character has z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "y and z exchanged, as for Unreal": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations, and the reflection of left-handed files, from a groom's axes to the character's."""
LARGEST_ROOT_DISTANCE = 0.02
"""Median distance of a groom's roots from the head beyond which it was made on another one [m]."""
SAMPLES = 500

Points = Float[np.ndarray, "s 3"]


def roots_on(
    surface: Triangles, roots: Points, in_body_space: Callable[[Points], Points], source: str
) -> tuple[Points, str]:
    """Roots in the body's space [m], and how they were read, in words; as they are in the file if that fits.

    Args:
        surface: of the head, in the file's pose, in the body's space [m].
        roots: of the groom [its file's units].
        in_body_space: from the character's scene to the body's space.
        source: the groom's file.

    Raises:
        InputError: a groom without roots, or one that was made on another head.
    """
    if not len(roots):
        raise InputError(source, "strands with roots", "none")
    some = roots[:: -(-len(roots) // SAMPLES)]
    distances: dict[tuple[float, str], float] = {}
    for unit, words in product(UNITS, TURNS):
        points = in_body_space(unit * some @ TURNS[words].T)
        apart = closest_on(points, surface)[2] - points
        distances[unit, words] = float(np.median(np.linalg.norm(apart, axis=1)))
        if len(distances) == 1 and distances[unit, words] < LARGEST_ROOT_DISTANCE:
            break
    (unit, words), away = min(distances.items(), key=lambda item: item[1])
    if away > LARGEST_ROOT_DISTANCE:
        first = next(iter(distances.values()))
        expected = (
            "roots on the head of the character, in its scene (a groom of another head needs none here: quaffure "
            "groom import --body fits it)"
        )
        raise InputError(source, expected, f"{first:.3g} m apart, {away:.3g} m in other axes and units")
    note = "" if (unit, words) == (1.0, next(iter(TURNS))) else f", read with {words}, a unit of it as {unit:g}"
    return in_body_space(unit * roots @ TURNS[words].T), note
