"""What a file says of its strands besides their shape: widths, colours, names; kept for export."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

UNKNOWN_ID = -1
LARGEST_ID = 2**30
"""Largest id that is kept: further ones after it must fit into 32 bits."""


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

    def usable(self) -> "StrandAttributes":
        """Without attributes that hold what float32 cannot, and without widths of which some are negative or none is
        positive."""
        most = float(np.finfo(np.float32).max)
        found = {name: values for name, values in self.arrays().items() if values.dtype.kind == "f"}
        broken: dict[str, Any] = {name: None for name, values in found.items() if not (np.abs(values) <= most).all()}
        if self.width is not None and not self.width.min(initial=0.0) >= 0 < self.width.max(initial=0.0):
            broken["width"] = None
        return replace(self, **broken)

    def with_groups_by_name(self) -> "StrandAttributes":
        """With groups of the same name as one, in the order in which names appear."""
        if self.group is None or len({*self.group_names}) == len(self.group_names):
            return self
        names = tuple(dict.fromkeys(self.group_names))
        place = np.array([*map(names.index, self.group_names), UNKNOWN_ID])  # of the last one, strands without a group
        return replace(self, group=place[self.group], group_names=names)

    def scaled(self, scale: float) -> "StrandAttributes":
        """Those of strands that are larger by a factor."""
        return self if self.width is None else replace(self, width=scale * self.width)

    def rearranged(self, order: Int[np.ndarray, " p"]) -> "StrandAttributes":
        """With the points in another order, each within its strand."""
        width, colour = (None if values is None else values[order] for values in (self.width, self.colour))
        return replace(self, width=width, colour=colour)

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


def concatenate_attributes(
    parts: Sequence[StrandAttributes], counts: Sequence[np.ndarray], names: Sequence[str]
) -> StrandAttributes:
    """Those of several files or objects.

    Where some parts have widths or colours, points of the others get the median width and the mean colour of these.
    Root coordinates are kept if all parts have them: no default is a place on the skin. Each part has groups of its
    own, at least one. Ids are -1 where a part has none.

    Args:
        counts: points of every strand of each part.
        names: of the parts, for groups of parts without groups.
    """
    parts = [part.usable() for part in parts]
    if len(parts) > 1:
        parts = [_with_groups(part, len(count), name) for part, count, name in zip(parts, counts, names)]
    joined: dict[str, Any] = {}
    for name, shape in {**POINT_ATTRIBUTES, **STRAND_ATTRIBUTES}.items():
        values = [getattr(part, name) for part in parts]
        known = [value for value in values if value is not None]
        if not known or (name == "root_uv" and len(known) < len(parts)):
            continue
        sizes = [int(count.sum()) if name in POINT_ATTRIBUTES else len(count) for count in counts]
        filled = [
            np.full((size, *shape), _default(name, known)) if value is None else value
            for value, size in zip(values, sizes)
        ]
        if name == "group":
            first = np.cumsum([0] + [len(part.group_names) for part in parts])
            filled = [np.where(value >= 0, value + start, value) for value, start in zip(filled, first)]
        joined[name] = np.concatenate(filled)
    return StrandAttributes(**joined, group_names=tuple(name for part in parts for name in part.group_names))


def _with_groups(part: StrandAttributes, count: int, name: str) -> StrandAttributes:
    return part if part.group is not None else replace(part, group=np.zeros(count, np.int64), group_names=(name,))


def _default(name: str, known: Sequence[np.ndarray]) -> Any:
    """Value of an attribute where a part has none, by those of the other parts."""
    if name == "width":
        return np.median(np.concatenate(known))
    return np.concatenate(known).mean(axis=0) if name == "colour" else UNKNOWN_ID


def groups_of(numbers: np.ndarray | None, names: np.ndarray | None, count: int, whole: str) -> StrandAttributes:
    """Groups of the strands of an object, in the order of their numbers: by name, without names by number.

    Args:
        numbers, names: of every strand's group, where there are any.
        count: of strands.
        whole: name of the object, which groups without a name have, with their number.
    """
    order = np.zeros(count) if numbers is None else numbers
    if numbers is None:
        labels = np.full(count, whole)
    else:
        unique, inverse = np.unique(numbers, return_inverse=True)
        labels = np.array([f"{whole}/{number:.0f}" for number in unique], dtype=str)[inverse]
    if names is not None:
        labels = np.where(names == "", labels, names)
    unique, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    ranked = np.lexsort((first, order[first]))
    return StrandAttributes(group=np.argsort(ranked)[inverse], group_names=tuple(map(str, unique[ranked])))


def unique_identifiers(identifier: Int[np.ndarray, " s"] | None) -> Int[np.ndarray, " s"] | None:
    """Ids of which each is there once: strands without one, with one of a strand before, or with one above
    `LARGEST_ID` get numbers after the largest. None where no strand has one."""
    if identifier is None:
        return None
    is_own = np.zeros(len(identifier), bool)
    is_own[np.unique(identifier, return_index=True)[1]] = True
    is_own &= (identifier >= 0) & (identifier <= LARGEST_ID)
    if not is_own.any():
        return None
    found = identifier.copy()
    found[~is_own] = identifier[is_own].max() + 1 + np.arange((~is_own).sum())
    return found


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
