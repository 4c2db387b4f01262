"""What a groom has to be for hair to be computed of it, the same where it is used, written and read."""

import math
from pathlib import Path
from weakref import WeakKeyDictionary

import torch

from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.strands import GOAL_WEIGHT, HELD_PARTS, SCALE_SLACK, STIFFNESS_SCALE, TIE_VERTEX
from quaffure.types import Tensor

LARGEST_COORDINATE = 10.0
"""Limit of the vertices of a groom, which is on a body at the origin [m], and of the coordinates of its roots [-]."""
SHORTEST_EDGE = 1e-6
"""Limit of an edge's length [m]; where bodies are, float32 places vertices a tenth of that apart."""
LONGEST_STRAND = 3.0
"""Limit of a strand's length [m]."""
LARGEST_SCALE, LARGEST_GOAL = 1e6, 100.0
"""Limits of `stiffness_scale` [-] and `goal_weight` [J]; beyond, float32 drowns all other forces."""
INTEGERS = (torch.int16, torch.int32, torch.int64)
"""Types of indices; torch takes smaller ones for masks."""
BARYCENTRIC_SLACK = 1e-3
_PASSED: WeakKeyDictionary[Groom, list[int | None]] = WeakKeyDictionary()
"""By groom, how often its arrays had been changed in place when they passed `check_layout` and `check_values`."""


def check_groom(groom: Groom, face_count: int | None = None) -> None:
    """Refuse a groom that no hair can be computed of. This is done before every drape, so what is not about finite
    numbers is checked again only when torch has noticed a change.

    Args:
        face_count: faces of the body that the groom is registered to, where that is known.

    Raises:
        InputError: no strands, NaN, infinity or a size of no groom [m] in its arrays, or what `check_layout` and
            `check_values` refuse.
    """
    arrays = groom.arrays()
    changes: list[int | None] = [face_count]
    for values in arrays.values():
        changes.append(values._version if isinstance(values, Tensor) and not values.is_inference() else None)
    has_passed = _PASSED.get(groom) == changes
    if not has_passed:
        check_layout(groom, groom.name)
    for name, values in arrays.items():
        if not values.is_floating_point():
            continue
        least, most = map(float, values.detach().aminmax())  # NaN where there is one
        limit = LARGEST_COORDINATE if name not in HELD_PARTS else math.inf
        if not (-limit <= least and most <= limit and math.isfinite(most - least)):
            expected = f"finite {name}" if limit == math.inf else f"finite {name} within +-{limit:g}"
            raise InputError(groom.name, expected, f"{least:.3g} to {most:.3g}")
    if not has_passed:
        check_values(groom, groom.name, face_count)
        _PASSED[groom] = changes


def check_layout(groom: Groom, source: str | Path) -> None:
    """Refuse arrays of other types and shapes than a groom's.

    Raises:
        InputError: there is one, or no strand of two vertices.
    """
    arrays = groom.arrays()
    for name, values in arrays.items():
        if not isinstance(values, Tensor):
            raise InputError(source, f"a tensor as {name}", f"a {type(values).__name__}")
    if groom.rest_strands.ndim != 3 or groom.rest_strands.shape[1] < 2 or groom.rest_strands.shape[2] != 3:
        expected = "rest_strands [strands, vertices >= 2, 3]"
        raise InputError(source, expected, f"{list(groom.rest_strands.shape)}")
    strands, vertices, _ = groom.rest_strands.shape
    if not strands:
        raise InputError(source, "at least one strand", "none")
    of_edges, integers = (strands, vertices - 1), ("root_faces", TIE_VERTEX)
    shapes = {
        "root_barycentric": (strands, 3),
        "root_uv": (strands, 2),
        STIFFNESS_SCALE: of_edges,
        GOAL_WEIGHT: of_edges,
    }
    for name, values in arrays.items():
        shape = shapes.get(name, (strands,) if name in integers else tuple(groom.rest_strands.shape))
        if tuple(values.shape) != shape:
            raise InputError(source, f"{name} of shape {list(shape)}", f"{list(values.shape)}")
        if not (values.dtype in INTEGERS if name in integers else values.is_floating_point()):
            kind = "whole" if name in integers else "real"
            raise InputError(source, f"{kind} numbers as {name}", f"{values.dtype}")


def check_values(groom: Groom, source: str | Path, face_count: int | None = None) -> None:
    """Refuse strands that are no hair, roots that are none, and held parts that nothing can hold.

    Args:
        face_count: as of `check_groom`.

    Raises:
        InputError: an edge as short as `SHORTEST_EDGE` or a strand as long as `LONGEST_STRAND`; a root off its face,
            its body or the scalp chart; a stiffness scale below 1, a goal below 0, one of either above its
            limit, or a tie that is no vertex.
    """
    lengths = groom.rest_lengths.detach()
    shortest, longest = float(lengths.min()), float(lengths.sum(dim=1).max())
    if not (shortest > SHORTEST_EDGE and longest < LONGEST_STRAND):
        expected = f"edges longer than {SHORTEST_EDGE:g} m and strands under {LONGEST_STRAND:g} m"
        raise InputError(source, expected, f"{shortest:.3g} m and {longest:.3g} m")
    weights = groom.root_barycentric.detach()
    off = max(-float(weights.min()), float((weights.sum(1) - 1).abs().max()))
    if not off <= BARYCENTRIC_SLACK:
        found = f"{float(weights.min()):.3g}..{float(weights.max()):.3g}"
        raise InputError(source, "barycentric coordinates that sum to 1", found)
    _check_range(groom.root_uv, 0.0, 1.0, "root_uv in the unit square", source)
    most = math.inf if face_count is None else face_count - 1
    _check_range(groom.root_faces, 0, most, "root_faces that are faces of the body", source)
    expected = f"{STIFFNESS_SCALE} from 1 to {LARGEST_SCALE:g}"
    _check_range(groom.stiffness_scale, 1 - SCALE_SLACK, LARGEST_SCALE, expected, source)
    _check_range(groom.goal_weight, 0.0, LARGEST_GOAL, f"{GOAL_WEIGHT} from 0 to {LARGEST_GOAL:g}", source)
    last = groom.rest_strands.shape[1] - 1
    _check_range(groom.tie_vertex, -1, last, f"{TIE_VERTEX} of -1 or a vertex of its strand", source)


def _check_range(values: Tensor | None, least: float, most: float, expected: str, source: str | Path) -> None:
    if values is None:
        return
    low, high = map(float, values.detach().aminmax())
    if not (least <= low and high <= most):
        raise InputError(source, expected, f"{low:.3g}..{high:.3g}")
