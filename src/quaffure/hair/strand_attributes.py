"""What a file says of its strands besides their shape: widths, colours, names; kept for the way out."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

UNKNOWN_ID = -1


@dataclass(frozen=True, eq=False)
class StrandAttributes:
    """Attributes in the order of the file, None where it has none.

    Attributes:
        width: of every point [file units].
        colour: of every point, linear RGB.
        identifier: of every strand; -1 where it has none.
        group: index in `group_names` of every strand.
        root_uv: texture coordinates of every strand's root on the file's own body.
        group_names: objects or groups of the file.
    """

    width: Float[np.ndarray, " p"] | None = None
    colour: Float[np.ndarray, "p 3"] | None = None
    identifier: Int[np.ndarray, " s"] | None = None
    group: Int[np.ndarray, " s"] | None = None
    root_uv: Float[np.ndarray, "s 2"] | None = None
    group_names: tuple[str, ...] = ()

    def arrays(self) -> dict[str, np.ndarray]:
        """The attributes that there are, by name; names of groups as text."""
        found: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        found["group_names"] = np.array(self.group_names) if self.group_names else None
        return {name: values for name, values in found.items() if values is not None}

    @staticmethod
    def of_arrays(arrays: dict[str, Any]) -> "StrandAttributes":
        """What `arrays` returned."""
        names = tuple(str(name) for name in arrays.get("group_names", ()))
        return StrandAttributes(**{**arrays, "group_names": names})

    def finite(self) -> "StrandAttributes":
        """Without attributes that hold what float32 cannot."""
        most = float(np.finfo(np.float32).max)
        found = {name: values for name, values in self.arrays().items() if values.dtype.kind == "f"}
        broken: dict[str, Any] = {name: None for name, values in found.items() if not (np.abs(values) <= most).all()}
        return replace(self, **broken)

    def rearranged(self, order: Int[np.ndarray, " p"], scale: float) -> "StrandAttributes":
        """With the points in another order, each within its strand, and widths times a factor."""
        width = None if self.width is None else scale * self.width[order]
        return replace(self, width=width, colour=None if self.colour is None else self.colour[order])

    def select(self, kept: Bool[np.ndarray, " s"], counts: Int[np.ndarray, " s"]) -> "StrandAttributes":
        """Those of some of the strands.

        Args:
            counts: points of every strand.
        """
        points = np.repeat(kept, counts)
        parts = {name: values for name, values in self.arrays().items() if name != "group_names"}
        changes: dict[str, Any] = {
            name: values[points if name in POINT_ATTRIBUTES else kept] for name, values in parts.items()
        }
        return replace(self, **changes)


POINT_ATTRIBUTES = {"width": (), "colour": (3,)}
STRAND_ATTRIBUTES = {"identifier": (), "group": (), "root_uv": (2,)}
"""Shape of each attribute of a point, and of a strand."""
NONE = StrandAttributes()


def concatenate_attributes(parts: Sequence[StrandAttributes], counts: Sequence[np.ndarray]) -> StrandAttributes:
    """Those of several files or objects; 0, and -1 for ids and groups, where a part has none. Each part has groups of
    its own.

    Args:
        counts: points of every strand of each part.
    """
    joined: dict[str, Any] = {}
    for name, shape in {**POINT_ATTRIBUTES, **STRAND_ATTRIBUTES}.items():
        values = [getattr(part, name) for part in parts]
        if all(value is None for value in values):
            continue
        sizes = [int(count.sum()) if name in POINT_ATTRIBUTES else len(count) for count in counts]
        missing: Any = UNKNOWN_ID if name in ("identifier", "group") else 0.0
        filled = [np.full((size, *shape), missing) if value is None else value for value, size in zip(values, sizes)]
        if name == "group":
            first = np.cumsum([0] + [len(part.group_names) for part in parts])
            filled = [np.where(value >= 0, value + start, value) for value, start in zip(filled, first)]
        joined[name] = np.concatenate(filled)
    return StrandAttributes(**joined, group_names=tuple(name for part in parts for name in part.group_names))


def along_points(values: np.ndarray, counts: Int[np.ndarray, " s"], points: Int[np.ndarray, " s"]) -> np.ndarray:
    """Values of curves' control points, at as many points along each curve as there are; linear in between."""
    if np.array_equal(counts, points):
        return values
    starts = np.cumsum(counts) - counts
    local = np.arange(points.sum()) - np.repeat(np.cumsum(points) - points, points)
    place = np.repeat(starts, points) + local * np.repeat((counts - 1) / np.maximum(points - 1, 1), points)
    below = np.clip(place.astype(np.int64), 0, np.repeat(starts + np.maximum(counts - 2, 0), points))
    share = (place - below).reshape(-1, *[1] * (values.ndim - 1))
    above = np.minimum(below + 1, len(values) - 1)
    mixed: np.ndarray = (1 - share) * values[below] + share * values[above]
    return mixed


def per_point(values: np.ndarray, counts: Int[np.ndarray, " s"], points: Int[np.ndarray, " s"]) -> np.ndarray | None:
    """Values of all, of every curve or of every control point, at every point of the polylines; None of other sizes."""
    if len(values) == 1:
        return np.repeat(values, int(points.sum()), axis=0)
    if len(values) == len(counts):
        return np.repeat(values, points, axis=0)
    return along_points(values, counts, points) if len(values) == counts.sum() else None


def per_strand(values: np.ndarray, counts: Int[np.ndarray, " s"]) -> np.ndarray | None:
    """Values of all, or of every curve, for every curve; None of other sizes."""
    if len(values) == 1:
        return np.repeat(values, len(counts), axis=0)
    return values if len(values) == len(counts) else None
