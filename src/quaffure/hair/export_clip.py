"""Strands of a drape as other programs take them, computed one frame at a time."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float32, Int, Int32
from scipy.spatial import cKDTree

from quaffure.errors import InputError
from quaffure.geometry.sampling import farthest_points
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom_binding import GroomBinding
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.hair.resample import arc_length_places, resample_held_parts, values_at_places
from quaffure.hair.strand_attributes import NONE, StrandAttributes, unique_identifiers
from quaffure.hair.strand_width import width_of
from quaffure.hair.strands import GOAL_WEIGHT, STIFFNESS_SCALE, TIE_VERTEX, UNASKED, Strands, held_parts_of

# Hsu et al. 2024 interpolate a full head from 128 guides.
MOST_GUIDES = 128
FEWEST_POINTS, MOST_POINTS = 2, 255
"""Vertices of a strand; Unreal takes no more."""
TIP_WIDTH = 0.35
"""Width of a tip, in widths of its root."""
HAIR_COLOUR, BODY_COLOUR = (0.15, 0.062, 0.025), (0.62, 0.50, 0.435)
"""Linear RGB."""


@dataclass(frozen=True)
class ExportSettings:
    """How strands are written for other programs."""

    points: int | None = None
    """Vertices of every strand in exported files, evenly spaced by arc length: 2 to 255. Without it, those of the
    drape."""
    every: int = 1
    """Write every Nth frame of the drape to exported files; the time between them grows by as much."""
    mesh: Literal["ribbons", "tubes"] = "ribbons"
    """Shape of strands in .glb, which has no curves: flat ribbons, or tubes of three sides."""
    skinned: bool = False
    """Write .glb with the body's skeleton: the body is skinned, and hair is attached to the head."""
    guides: bool = False
    """Write the guides to .usd*, too: curves that viewers hide, and that strands are interpolated between."""
    frames_per_layer: int | None = None
    """Write the frames of .usd* to files of N frames each beside it (walk.0000.usd, walk.0100.usd and so on), which it
    names as value clips: programs open only the one that they play."""

    def __post_init__(self) -> None:
        if self.points is not None and not FEWEST_POINTS <= self.points <= MOST_POINTS:
            raise InputError("--points", f"{FEWEST_POINTS} to {MOST_POINTS} vertices of a strand", f"{self.points}")
        if self.every < 1:
            raise InputError("--every", "1 or more", f"{self.every}")
        if self.frames_per_layer is not None and self.frames_per_layer < 1:
            raise InputError("--frames-per-layer", "1 or more", f"{self.frames_per_layer}")


@dataclass(frozen=True)
class ExportClip:
    """A drape, and how to write it.

    A strand is a draped one, or, with an interpolation, one between them. Guides are a few of the draped strands, or,
    with an interpolation, all of them.

    Attributes:
        sequence: the drape; its arrays may be files that are read as they are used.
        interpolation: of strands between the draped ones.
        binding: groom and body at rest; without it, rest is the first frame's posed groom.
        settings: how to write it.
    """

    sequence: DrapeSequence
    interpolation: GuideInterpolation | None = None
    binding: GroomBinding | None = None
    settings: ExportSettings = ExportSettings()

    @property
    def frames(self) -> range:
        """Frames of the drape that are written."""
        return range(0, len(self.sequence), self.settings.every)

    @property
    def times(self) -> Float32[np.ndarray, " f"]:
        """Times of these frames [s]."""
        return (np.array(self.frames) / self.sequence.fps).astype(np.float32)

    @property
    def point_count(self) -> int:
        """Vertices of a strand, and of a guide."""
        own = self.sequence.strands.shape[2] if self.interpolation is None else self.interpolation.vertex_count
        return self.settings.points or own

    @property
    def strand_count(self) -> int:
        return self.sequence.strands.shape[1] if self.interpolation is None else len(self.interpolation)

    @cached_property
    def guide_index(self) -> Int[np.ndarray, " g"]:
        """The draped strands that are guides."""
        if self.interpolation is not None:
            return np.arange(self.sequence.strands.shape[1])
        return np.asarray(farthest_points(self._rest_guides[:, 0], MOST_GUIDES))

    @cached_property
    def counts(self) -> Int32[np.ndarray, " m"]:
        """Vertices of every strand: those of its source, or as many of all as the settings say."""
        if self.interpolation is None or self.settings.points is not None:
            return np.full(self.strand_count, self.point_count, np.int32)
        return self.interpolation.counts.astype(np.int32)

    def points(self, frame: int) -> Float32[np.ndarray, "v 3"]:
        """Vertices of all strands of a frame one after another, as many of each as `counts` says [m, world]."""
        return self._points(np.asarray(self.sequence.strands[frame]), self.sequence.body_vertices[frame])

    @cached_property
    def rest_points(self) -> Float32[np.ndarray, "v 3"]:
        """The same at rest."""
        return self._own_rest if self._keeps_points else self._evenly(self._own_rest).reshape(-1, 3)

    def strands(self, frame: int) -> Float32[np.ndarray, "m p 3"]:
        """Strands of a frame with as many vertices each [m, world]."""
        return self._evenly(self._own_points(self.sequence.strands[frame], self.sequence.body_vertices[frame]))

    def guides(self, frame: int) -> Float32[np.ndarray, "g p 3"]:
        """Guides of a frame [m, world]."""
        return self._resampled(np.asarray(self.sequence.strands[frame])[self.guide_index])

    @property
    def rest_guides(self) -> Float32[np.ndarray, "g p 3"]:
        """Guides at rest [m, world]."""
        return self._resampled(self._rest_guides[self.guide_index])

    @cached_property
    def root_uv(self) -> Float32[np.ndarray, "m 2"] | None:
        """Texture coordinates of the body at the strands' roots, where their source or a binding gives them."""
        if self._attributes.root_uv is not None:
            return self._attributes.root_uv.astype(np.float32)
        if self.binding is None:
            return None
        if self.interpolation is None:
            return self.binding.root_uv.astype(np.float32)
        return _uv_at(self.binding, self.sequence.body_faces, self.interpolation)

    @cached_property
    def guide_root_uv(self) -> Float32[np.ndarray, "g 2"] | None:
        """The same of the guides, on the same texture: where the source gives them, those of its nearest root."""
        own = self._attributes.root_uv
        if own is not None:
            return own[self._strand_of_guide].astype(np.float32)
        return None if self.binding is None else self.binding.root_uv[self.guide_index].astype(np.float32)

    @cached_property
    def closest_guides(self) -> tuple[Int32[np.ndarray, "m 3"], Float32[np.ndarray, "m 3"]]:
        """Three guides of every strand, counted among the guides, and their weights, which sum to 1; of a strand that
        no guide moves, off the scalp, the nearest alone. Files name guides by `guide_identifiers`."""
        if self.interpolation is not None:
            guides, weights = self.interpolation.guides, self.interpolation.weights.copy()
            weights[weights.sum(axis=1) <= 0, 0] = 1.0
            return guides, weights
        roots = self._rest_guides[:, 0]
        nearest = min(3, len(self.guide_index))
        distance, guides = cKDTree(roots[self.guide_index]).query(roots, k=[*range(1, nearest + 1)])
        weights = 1 / np.maximum(distance, 1e-6)
        missing = ((0, 0), (0, 3 - nearest))
        guides, weights = np.pad(guides, missing, mode="edge"), np.pad(weights, missing)
        return guides.astype(np.int32), (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)

    @property
    def strand_width(self) -> Float32[np.ndarray, " p"]:
        """Width of a strand at each of its vertices [m]: as many as there are, they cover the head."""
        return _tapered(width_of(self.strand_count), np.linspace(0.0, 1.0, self.point_count))

    @cached_property
    def widths(self) -> Float32[np.ndarray, " v"]:
        """Width of the strands at each of `points` [m]: that of their source, or tapering to the tip."""
        if self._attributes.width is not None:
            return self._at_points(self._attributes.width)
        return _tapered(width_of(self.strand_count), self._share_of_way)

    @cached_property
    def colours(self) -> Float32[np.ndarray, "v 3"]:
        """Linear RGB at each of `points`: that of their source, or `HAIR_COLOUR`."""
        if self._attributes.colour is not None:
            return self._at_points(self._attributes.colour.clip(min=0.0))
        return np.tile(np.array(HAIR_COLOUR, np.float32), (int(self.counts.sum()), 1))

    @property
    def has_colours(self) -> bool:
        """Whether the source has colours."""
        return self._attributes.colour is not None

    @cached_property
    def identifiers(self) -> Int32[np.ndarray, " m"] | None:
        """Numbers that the strands have in their source, where it has some, and others for its other strands."""
        found = unique_identifiers(self._attributes.identifier)
        return None if found is None else found.astype(np.int32)

    @property
    def guide_identifiers(self) -> Int32[np.ndarray, " g"]:
        """Numbers of the guides: from 0, or the smallest that no strand of a source has. Unreal reads the numbers of
        closest guides into float32, which is exact up to 2**24."""
        count = len(self.guide_index)
        if self.identifiers is None:
            return np.arange(count, dtype=np.int32)
        return np.setdiff1d(np.arange(self.strand_count + count), self.identifiers)[:count].astype(np.int32)

    @property
    def groups(self) -> Int32[np.ndarray, " m"]:
        """Index of every strand's group in `group_names`; strands without one are in the last."""
        found = self._attributes.group
        if found is None:
            return np.zeros(self.strand_count, np.int32)
        return np.where(found < 0, len(self._attributes.group_names), found).astype(np.int32)

    @property
    def guide_groups(self) -> Int32[np.ndarray, " g"]:
        """Those of the guides: of the nearest strand, as Unreal finds closest guides within a strand's group alone."""
        return self.groups[self._strand_of_guide] if self.has_groups else np.zeros(len(self.guide_index), np.int32)

    @property
    def has_groups(self) -> bool:
        """Whether the source divides its strands into groups."""
        return self._attributes.group is not None

    @property
    def group_names(self) -> tuple[str, ...]:
        """Names of the source's groups, and that of the groom for strands without one."""
        names, found = self._attributes.group_names, self._attributes.group
        if names and (found is None or bool((found >= 0).all())):
            return names
        return (*names, str(self.sequence.meta.get("groom", "hair")))

    @cached_property
    def held_parts(self) -> dict[str, np.ndarray]:
        """Those of `HELD_PARTS` that the drape has, of every strand: edges at their first vertices, the tip repeats the
        last; a value for each of `points`, of the tie one of each strand. A strand has those of its nearest guide,
        resampled to its own vertices; one that no guide moves, off the scalp, is not held."""
        nearest, is_moved = np.arange(self.strand_count), np.ones(self.strand_count, dtype=bool)
        if self.interpolation is not None:
            nearest, is_moved = self.interpolation.guides[:, 0], self.interpolation.weights.sum(axis=1) > 0
        starts, parts = np.cumsum(self.counts) - self.counts, dict[str, np.ndarray]()
        for count in np.unique(self.counts[is_moved]).tolist():
            strands = np.flatnonzero(is_moved & (self.counts == count))
            guides, row = np.unique(nearest[strands], return_inverse=True)
            for name, values in self._held_parts(guides, count).items():
                at, size = strands, self.strand_count
                if name != TIE_VERTEX:
                    at, size = starts[strands, None] + np.arange(count), int(self.counts.sum())
                parts.setdefault(name, np.full(size, UNASKED[name], values.dtype))[at] = values[row]
        return parts

    @property
    def guide_held_parts(self) -> dict[str, np.ndarray]:
        """The same of the guides."""
        return self._held_parts(self.guide_index, self.point_count)

    def body_vertices(self, frame: int) -> Float[np.ndarray, "v 3"]:
        """Vertices of the body in a frame [m, world]."""
        return np.asarray(self.sequence.body_vertices[frame])

    @property
    def body_faces(self) -> Int32[np.ndarray, "k 3"]:
        """Triangles of the body."""
        return self.sequence.body_faces

    @property
    def body_uv(self) -> Float32[np.ndarray, "k 3 2"] | None:
        """Texture coordinates of the corners of the body's triangles, where a binding tells them."""
        return None if self.binding is None else self.binding.body_uv

    @property
    def up_axis(self) -> str:
        return "z"

    @property
    def start(self) -> float:
        """Time of the first frame [s]."""
        return 0.0

    @property
    def _rest_guides(self) -> Float[np.ndarray, "s n 3"]:
        return np.asarray(self.sequence.posed[0]) if self.binding is None else self.binding.strands

    @property
    def _rest_body(self) -> Float[np.ndarray, "b 3"]:
        return np.asarray(self.sequence.body_vertices[0] if self.binding is None else self.binding.body_vertices)

    @cached_property
    def _own_rest(self) -> Float32[np.ndarray, "o 3"]:
        return self._own_points(self._rest_guides, self._rest_body)

    @cached_property
    def _strand_of_guide(self) -> Int[np.ndarray, " g"]:
        """The strand whose root is nearest to each guide's."""
        roots = self._own_rest[np.cumsum(self._own_counts) - self._own_counts]
        return np.asarray(cKDTree(roots).query(self._rest_guides[self.guide_index, 0])[1])

    @property
    def _attributes(self) -> StrandAttributes:
        return NONE if self.interpolation is None else self.interpolation.attributes

    @property
    def _keeps_points(self) -> bool:
        """Whether strands have the points of their source."""
        return self.settings.points is None

    @cached_property
    def _share_of_way(self) -> Float[np.ndarray, " v"]:
        """How far along its strand each of `points` is, counted in vertices."""
        starts = np.cumsum(self.counts) - self.counts
        local = np.arange(self.counts.sum()) - np.repeat(starts, self.counts)
        return local / np.repeat(np.maximum(self.counts - 1, 1), self.counts)

    def _points(self, guides: np.ndarray, body_vertices: np.ndarray) -> Float32[np.ndarray, "v 3"]:
        own = self._own_points(guides, body_vertices)
        return own if self._keeps_points else self._evenly(own).reshape(-1, 3)

    def _own_points(self, guides: np.ndarray, body_vertices: np.ndarray) -> Float32[np.ndarray, "o 3"]:
        """Vertices of the strands before they are resampled, as many of each as `_own_counts` says."""
        guides, body_vertices = (np.ascontiguousarray(part, dtype=np.float32) for part in (guides, body_vertices))
        return guides.reshape(-1, 3) if self.interpolation is None else self.interpolation.points(guides, body_vertices)

    @property
    def _own_counts(self) -> Int[np.ndarray, " m"]:
        if self.interpolation is None:
            return np.full(self.strand_count, self.sequence.strands.shape[2])
        return self.interpolation.counts

    def _evenly(self, own: Float32[np.ndarray, "o 3"]) -> Float32[np.ndarray, "m p 3"]:
        """Strands with `point_count` vertices each."""
        if (self._own_counts == self.point_count).all():
            return own.reshape(-1, self.point_count, 3)
        return values_at_places(own, *self._places)

    def _at_points(self, values: Float[np.ndarray, "o ..."]) -> Float32[np.ndarray, "v ..."]:
        """Values of the source's vertices at each of `points`."""
        found = values.astype(np.float32)
        if self._keeps_points or (self._own_counts == self.point_count).all():
            return found
        return values_at_places(found, *self._places).reshape(-1, *found.shape[1:])

    def _resampled(self, guides: np.ndarray) -> Float32[np.ndarray, "g p 3"]:
        if self.point_count == guides.shape[1]:
            return np.ascontiguousarray(guides, dtype=np.float32)
        return values_at_places(guides.reshape(-1, 3), *self._guide_places)

    @cached_property
    def _places(self) -> tuple[Int[np.ndarray, "m p"], Float32[np.ndarray, "m p"]]:
        """Along strands at rest: drapes keep their lengths."""
        return _places(Strands(self._own_rest, self._own_counts, "strands"), self.point_count)

    @cached_property
    def _guide_places(self) -> tuple[Int[np.ndarray, "g p"], Float32[np.ndarray, "g p"]]:
        return _places(_as_strands(self._rest_guides[self.guide_index]), self.point_count)

    def _held_parts(self, chosen: Int[np.ndarray, " c"], count: int) -> dict[str, np.ndarray]:
        """Those of the chosen draped strands, resampled to so many vertices."""
        parts: dict[str, Any] = {name: values[chosen] for name, values in held_parts_of(self.sequence).items()}
        rest, own_tie = self._rest_guides[chosen], parts.get(TIE_VERTEX)
        if parts and count != rest.shape[1]:
            of_points: dict[str, Any] = {
                name: values if name == TIE_VERTEX else _at_vertices(values) for name, values in parts.items()
            }
            parts = resample_held_parts(replace(_as_strands(rest), **of_points), count)
        if own_tie is not None:  # at few vertices, the nearest to a tie may be the root, which is never tied
            parts[TIE_VERTEX] = np.where(own_tie > 0, parts[TIE_VERTEX].clip(min=1), parts[TIE_VERTEX])
        for name in {STIFFNESS_SCALE, GOAL_WEIGHT} & {*parts}:
            parts[name] = _at_vertices(parts[name]).reshape(-1, count)
        return parts


def _tapered(width: float, share_of_way: Float[np.ndarray, " v"]) -> Float32[np.ndarray, " v"]:
    """Width of a strand so far along it, from 0 at its root to 1 at its tip."""
    return (width * (1 - (1 - TIP_WIDTH) * share_of_way)).astype(np.float32)


def _at_vertices(of_edges: np.ndarray) -> np.ndarray:
    return np.pad(of_edges, ((0, 0), (0, 1)), mode="edge").ravel()


def _as_strands(rest: np.ndarray) -> Strands:
    return Strands(rest.reshape(-1, 3), np.full(len(rest), rest.shape[1]), "strands")


def _places(rest: Strands, count: int) -> tuple[np.ndarray, np.ndarray]:
    right, weight = arc_length_places(rest, count)
    return right, weight.astype(np.float32)


def _uv_at(
    binding: GroomBinding, faces: Int[np.ndarray, "k 3"], interpolation: GuideInterpolation
) -> Float32[np.ndarray, "m 2"]:
    """Texture coordinates of the body at the roots of strands between guides."""
    base = int(faces.max()) + 1
    place = np.array([base * base, base, 1], dtype=np.int64)
    keys, wanted = faces @ place, interpolation.carriers @ place
    order = keys.argsort()
    face = order[np.searchsorted(keys, wanted, sorter=order)]
    return (interpolation.root_weights[..., None] * binding.body_uv[face]).sum(axis=1).astype(np.float32)
