"""Whether faces of a surface are a scalp, and what was mended where they are nearly one."""

import numpy as np
from jaxtyping import Bool, Float, Int

from quaffure.character.collision_surface import Triangles
from quaffure.character.scalp_chart import face_neighbours, pieces
from quaffure.errors import InputError

LARGEST_REPAIR = 1e-3
"""Area of the largest hole that is filled, and of the largest piece that is left out: 3.5 cm across [m^2]."""
LEAST_NOTED = 2e-5
"""Less than this is the width of a triangle along the rim [m^2]."""
REACH = 0.05
"""How far the hairline can be from where it is on the shipped head: that of a low forehead, or of a nape [m]."""


def check_scalp(
    surface: Triangles,
    wanted: Bool[np.ndarray, " k"],
    chosen: Bool[np.ndarray, " k"],
    ears: Int[np.ndarray, " e"],
    source: str,
) -> tuple[str, ...]:
    """What was mended between the faces that were asked for and the disc that was made of them, in words.

    Raises:
        InputError: a large hole is filled, or a large piece left out.
    """
    area = face_areas(surface)
    on_ear = np.isin(surface.faces, ears).any(1)
    lost = _areas(wanted & ~chosen & ~on_ear, surface, area)
    if lost.max(initial=0.0) > LARGEST_REPAIR:
        sizes = sorted([area[chosen].sum(), *lost[lost > LARGEST_REPAIR]], reverse=True)
        found = f"{len(sizes)} pieces of {', '.join(f'{1e4 * size:.0f}' for size in sizes)} cm^2"
        raise InputError(source, "a scalp in one piece", found)
    filled = _areas(chosen & ~wanted & ~on_ear, surface, area)
    if filled.max(initial=0.0) > LARGEST_REPAIR:
        expected = f"a closed scalp, holes in it at most {1e4 * LARGEST_REPAIR:.0f} cm^2 large"
        raise InputError(source, expected, f"an open scalp with a hole of {1e4 * filled.max():.0f} cm^2")
    notes = []
    for what, areas in (("holes filled", filled), ("pieces left out", lost)):
        if (count := int((areas > LEAST_NOTED).sum())) > 0:
            notes.append(f"{count} small {what} ({1e4 * areas[areas > LEAST_NOTED].sum():.1f} cm^2 in all)")
    if (on_ear & wanted & ~chosen).any():
        notes.append("ears left out")
    if (on_ear & chosen).any():
        notes.append("ears within it covered")
    return tuple(notes)


def within_reach(
    wanted: Bool[np.ndarray, " k"], distance: Float[np.ndarray, " k"], surface: Triangles, source: str
) -> Bool[np.ndarray, " k"]:
    """The faces that can be scalp.

    Args:
        distance: of each face from where the shipped body's scalp would be [m].

    Raises:
        InputError: too many others: a skin, for instance, and not the part of it that has hair.
    """
    beyond = wanted & (distance > REACH)
    areas = _areas(beyond, surface, face_areas(surface))
    if areas.max(initial=0.0) > LARGEST_REPAIR:
        expected = f"a scalp within {100 * REACH:g} cm of where a head has one"
        found = f"{1e4 * areas.sum():.0f} cm^2 farther from it, over face, neck or shoulders"
        raise InputError(source, expected, found)
    return wanted & ~beyond


def face_areas(surface: Triangles) -> Float[np.ndarray, " k"]:
    """[m^2]."""
    corners = surface.vertices[surface.faces]
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def _areas(chosen: Bool[np.ndarray, " k"], surface: Triangles, area: Float[np.ndarray, " k"]) -> np.ndarray:
    """Areas of the pieces of some faces that are connected by edges [m^2]."""
    sums = np.bincount(pieces(chosen, face_neighbours(surface.faces)), weights=area * chosen)
    return sums[sums > 0]
