"""Stiffness, goals and ties in files: their layout in `.npz`, and what their values have to be."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from quaffure.errors import InputError
from quaffure.hair.strands import GOAL_WEIGHT, SCALE_SLACK, STIFFNESS_SCALE, TIE_VERTEX
from quaffure.npz import INTEGER, NUMBER, Spec

# S strands, E edges of a strand.
HELD_PARTS_SPEC: Spec = {
    STIFFNESS_SCALE: (("S", "E"), NUMBER),
    GOAL_WEIGHT: (("S", "E"), NUMBER),
    TIE_VERTEX: (("S",), INTEGER),
}


def checked_held_parts(
    arrays: Mapping[str, np.ndarray], counts: int | np.ndarray, source: str | Path
) -> dict[str, np.ndarray]:
    """Held parts in the types of a groom, scales of 1 and above, goals of 0 and above, ties on their strands.

    Args:
        arrays: those of `HELD_PARTS` that a file has, of the shapes that they should have.
        counts: vertices of each strand.

    Raises:
        InputError: other values.
    """
    found: dict[str, np.ndarray] = {}
    for name, least in ((STIFFNESS_SCALE, 1.0), (GOAL_WEIGHT, 0.0)):
        if name in arrays:
            values = arrays[name].astype(np.float32)
            if not (np.isfinite(values).all() and (values >= least - SCALE_SLACK * least).all()):
                raise InputError(source, f"{name} of {least:g} and above", f"{values.min():.3g}..{values.max():.3g}")
            found[name] = values.clip(min=least)
    if TIE_VERTEX in arrays:
        vertices = arrays[TIE_VERTEX].astype(np.int64)
        if not ((vertices >= -1) & (vertices < counts)).all():
            raise InputError(
                source, f"{TIE_VERTEX} of -1 or a vertex of its strand", f"{vertices.min()}..{vertices.max()}"
            )
        found[TIE_VERTEX] = vertices
    return found
