"""Ties in a groom that does not name them: places where strands from roots far apart come together.

Straight hair is dense away from the scalp too, so density alone takes most of it for tied. What sets a tie apart:

- Its hair comes from all over a part of the scalp. Strands that fall side by side, straight or in locks, have their
  roots on a narrow strip. The spread of the roots across their own longest direction, over the distance at which the
  strands pass the tie, is at least 3.3 in procedural ties, and mostly below 2.5 in free hair.
- It passes alone. Within twice the radius of a procedural tie there are at most 1.08 times as many strands. Free hair
  that converges like a tie has more of its kind around it: 1.32 times as many and above.

A tail that is modelled as strands of their own, with their roots in the tie, is found by the density of these roots
(`quaffure.hair.rooted_tails`).
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from quaffure.hair.groom import Groom
from quaffure.hair.rooted_tails import strands_that_end_at_tails

SAMPLES_PER_EDGE = 4
LEAST_ARC = 0.02
"""Hair this near its root is not in a tie yet [m]; roots are dense by themselves."""
CELL = 0.025
"""Size of the cells in which strands meet [m]: the diameter of a tie."""
FEWEST, LEAST_SHARE = 20, 0.02
"""Strands in a tie: at least this many, and this share of the groom."""
LEAST_ALIGNMENT = 0.5
"""Length of the mean of the unit directions in a cell."""
LEAST_ROOT_SPREAD = 0.018
"""Standard deviation of the roots of a tie in the second longest of their directions [m]."""
LEAST_CONVERGENCE = 2.5
"""That spread, relative to the median distance at which the strands pass the centre of the tie."""
MOST_AROUND = 1.2
"""Strands that pass within twice the radius, relative to those of the tie."""
SIMILAR_COUNT, SIMILAR_DISTANCE = 0.5, 1.25
"""Cells of a tie: those with this share of the strands of the best. Of them the first is taken whose strands pass
nearly as close together as anywhere before or shortly after, by this factor: tails narrow again to their tips."""
WAIST = 4.0
"""How far after it [edges]."""
RADII = (0.010, 0.030)
"""Least and largest radius within which strands belong to a tie [m]; between, `RADIUS` times their median distance."""
RADIUS = 2.5
LEAST_WINDING = 0.75
"""Winding number about the axis of the tie, beyond it, from which on a tail is a bun."""
SHORT_END = 0.02
"""A strand that ends within this length of its tie ends in it [m]."""
MOST_TRIALS = 12
"""Places that are tried, as ties or not."""
SAMPLED_MEMBERS = 200
"""Strands of a tie from which its centre is found."""


@dataclass(frozen=True)
class FoundTie:
    """One tie.

    Attributes:
        centre: [m].
        strands: number of its strands.
        wound: whether the hair is wound up beyond it, as in a bun.
        root_spread: standard deviation of the roots across their longest direction [m].
    """

    centre: tuple[float, float, float]
    strands: int
    wound: bool
    root_spread: float

    def __str__(self) -> str:
        form = "wound up at" if self.wound else "to"
        return f"{self.strands} {form} {' '.join(f'{value:z.2f}' for value in self.centre)} m"


class _Samples(NamedTuple):
    """Points along all strands, more than `LEAST_ARC` from the roots on.

    Attributes:
        points, direction: [m] and unit.
        strand, position: index of the strand, and place on it in edges.
    """

    points: Float[np.ndarray, "p 3"]
    direction: Float[np.ndarray, "p 3"]
    strand: Int[np.ndarray, " p"]
    position: Float[np.ndarray, " p"]

    def select(self, kept: Bool[np.ndarray, " p"]) -> "_Samples":
        return _Samples(*(values[kept] for values in self))


class _Cells(NamedTuple):
    """Cells that many aligned strands pass: mean point [m], number of strands, spread of their roots [m]."""

    centre: Float[np.ndarray, "c 3"]
    strands: Int[np.ndarray, " c"]
    spread: Float[np.ndarray, " c"]


class _Passing(NamedTuple):
    """Strands that pass a place.

    Attributes:
        members: which.
        position: where on each strand it is [edges].
        distance: their median distance from the place [m].
        around: strands within twice the radius, relative to them.
        root_spread: [m].
    """

    members: Bool[np.ndarray, " s"]
    position: Float[np.ndarray, " s"]
    distance: float
    around: float
    root_spread: float

    @property
    def is_tie(self) -> bool:
        converges = self.root_spread >= max(LEAST_ROOT_SPREAD, LEAST_CONVERGENCE * self.distance)
        return converges and self.around <= MOST_AROUND


def find_ties(groom: Groom) -> tuple[Int[Tensor, " s"], list[FoundTie]]:
    """Vertex up to which each strand is held by a tie, -1 for none, and the ties."""
    strands = groom.rest_strands.double().cpu().numpy()
    held_to, ties, rejected = np.full(len(strands), -1), list[FoundTie](), list[Float[np.ndarray, "3"]]()
    samples = _sampled(strands)
    fewest = max(FEWEST, math.ceil(LEAST_SHARE * len(strands)))
    cells = _cells(samples, strands[:, 0], fewest)
    for _ in range(MOST_TRIALS):
        score = cells.spread * np.sqrt(cells.strands)
        for centre in rejected:
            score[np.linalg.norm(cells.centre - centre, axis=1) < 2 * CELL] = 0
        if not score.any():
            break
        best = int(score.argmax())
        centre = _narrowest(cells, best, samples)
        passing = _passing(samples, centre, strands[:, 0])
        if passing.members.sum() < fewest or not passing.is_tie:
            rejected += [centre, cells.centre[best]]
            continue
        members = np.flatnonzero(passing.members)
        held_to[members], wound = _held_to(strands[members], passing.position[members], centre)
        ties.append(FoundTie(tuple(centre.tolist()), len(members), wound, passing.root_spread))
        samples = samples.select(~passing.members[samples.strand])
        cells = _cells(samples, strands[:, 0], fewest)
    for centre, ends in strands_that_end_at_tails(strands, held_to >= 0):
        spread = root_spread(strands[ends, 0])
        if len(ends) >= FEWEST and spread >= LEAST_ROOT_SPREAD:
            held_to[ends] = strands.shape[1] - 1
            ties.append(FoundTie(tuple(centre.tolist()), len(ends), False, spread))
    return torch.from_numpy(held_to), ties


def root_spread(roots: Float[np.ndarray, "m 3"]) -> float:
    """Standard deviation of roots in the second longest of their directions [m]."""
    if len(roots) < 2:
        return 0.0
    return float(np.linalg.svd(roots - roots.mean(0), compute_uv=False)[1] / math.sqrt(len(roots)))


def _sampled(strands: Float[np.ndarray, "s n 3"]) -> _Samples:
    count, vertices, _ = strands.shape
    share = (np.arange(SAMPLES_PER_EDGE) + 0.5) / SAMPLES_PER_EDGE
    edges = np.diff(strands, axis=1)
    lengths = np.linalg.norm(edges, axis=-1)
    points = strands[:, :-1, None] + share[:, None] * edges[:, :, None]
    direction = np.repeat(edges / lengths.clip(min=1e-9)[..., None], SAMPLES_PER_EDGE, axis=1)
    arc = np.cumsum(np.repeat(lengths / SAMPLES_PER_EDGE, SAMPLES_PER_EDGE, axis=1), axis=1)
    position = (np.arange(vertices - 1)[:, None] + share).ravel()
    every = _Samples(
        points.reshape(-1, 3),
        direction.reshape(-1, 3),
        np.repeat(np.arange(count), len(position)),
        np.tile(position, count),
    )
    return every.select(arc.ravel() > LEAST_ARC)


def _cells(samples: _Samples, roots: Float[np.ndarray, "s 3"], fewest: int) -> _Cells:
    """Cells of eight grids, each moved by half a cell: every tie lies well inside a cell of one."""
    if not len(samples.strand):
        return _Cells(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0))
    found = [_cells_of_grid(samples, roots, fewest, 0.5 * np.array(shift)) for shift in product((0, 1), repeat=3)]
    return _Cells(*(np.concatenate(values) for values in zip(*found)))


def _cells_of_grid(
    samples: _Samples, roots: Float[np.ndarray, "s 3"], fewest: int, shift: Float[np.ndarray, "3"]
) -> _Cells:
    index = np.floor(samples.points / CELL + shift).astype(np.int64)
    sizes = np.ptp(index, axis=0) + 1
    key = np.ravel_multi_index(tuple((index - index.min(0)).T), tuple(sizes))
    # A strand counts once in a cell.
    first = np.unique(key * len(roots) + samples.strand, return_index=True)[1]
    _, cell, count = np.unique(key[first], return_inverse=True, return_counts=True)
    kept = count[cell] >= fewest
    first = first[kept]
    if not len(first):
        return _Cells(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0))
    _, cell, count = np.unique(cell[kept], return_inverse=True, return_counts=True)

    def mean(values: Float[np.ndarray, "p d"]) -> Float[np.ndarray, "c d"]:
        sums = [np.bincount(cell, column, len(count)) for column in values.T]
        return np.stack(sums, axis=1) / count[:, None]

    own = roots[samples.strand[first]]
    from_mean = own - mean(own)[cell]
    covariance = mean((from_mean[:, :, None] * from_mean[:, None]).reshape(-1, 9)).reshape(-1, 3, 3)
    spread = np.sqrt(np.linalg.eigvalsh(covariance)[:, 1].clip(min=0))
    aligned = np.linalg.norm(mean(samples.direction[first]), axis=1) >= LEAST_ALIGNMENT
    kept = aligned & (spread >= LEAST_ROOT_SPREAD)
    return _Cells(mean(samples.points[first])[kept], count[kept], spread[kept])


def _narrowest(cells: _Cells, best: int, samples: _Samples) -> Float[np.ndarray, "3"]:
    """Centre of the first waist of the strands of the best cell."""
    near = np.linalg.norm(samples.points - cells.centre[best], axis=1) < 0.5 * CELL
    members = np.unique(samples.strand[near])
    own = samples.select(np.isin(samples.strand, members[:: math.ceil(len(members) / SAMPLED_MEMBERS)]))
    centres = cells.centre[cells.strands >= SIMILAR_COUNT * cells.strands[best]]
    distance, reached = np.empty(len(centres)), np.empty(len(centres))
    for place in range(len(centres)):
        # A cell holds a part of the tie: its mean is not the centre, where the strands come closest to it is.
        centres[place] = np.median(own.points[_closest(own, centres[place])[1]], axis=0)
        nearest, index = _closest(own, centres[place])
        distance[place], reached[place] = np.median(nearest), np.median(own.position[index])
    until = reached <= reached[:, None] + WAIST
    tight = distance <= SIMILAR_DISTANCE * np.where(until, distance, np.inf).min(axis=1)
    return centres[np.where(tight, reached, np.inf).argmin()]


def _closest(samples: _Samples, point: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Distance of every strand that has samples from a point [m], and the index of its closest sample."""
    distance = np.linalg.norm(samples.points - point, axis=1)
    starts = np.flatnonzero(np.diff(samples.strand, prepend=-1))
    nearest = np.minimum.reduceat(distance, starts)
    order = np.lexsort((distance, samples.strand))[starts]
    return nearest, order


def _passing(samples: _Samples, centre: Float[np.ndarray, "3"], roots: Float[np.ndarray, "s 3"]) -> _Passing:
    distance, position = np.full(len(roots), np.inf), np.zeros(len(roots))
    nearest, index = _closest(samples, centre)
    distance[samples.strand[index]], position[samples.strand[index]] = nearest, samples.position[index]
    near = distance < RADII[1]
    median = float(np.median(distance[near])) if near.any() else np.inf
    radius = np.clip(RADIUS * median, *RADII)
    members = distance < radius
    around = float((distance < 2 * radius).sum() / max(members.sum(), 1))
    return _Passing(members, position, median, around, root_spread(roots[members]))


def _held_to(
    strands: Float[np.ndarray, "m n 3"], position: Float[np.ndarray, " m"], centre: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, " m"], bool]:
    """Vertex in the tie of each strand, its tip where it ends there or is wound up beyond; and whether it is."""
    last = strands.shape[1] - 1
    vertex = np.rint(position).astype(np.int64).clip(1, last)
    edges = np.diff(strands, axis=1)
    at_tie = np.take_along_axis(edges, vertex.clip(max=last - 1)[:, None, None], axis=1)[:, 0]
    axis = at_tie.mean(0) / max(float(np.linalg.norm(at_tie.mean(0))), 1e-9)
    beyond = np.arange(last + 1) >= vertex[:, None]
    offset = strands - centre
    across = offset - (offset @ axis)[..., None] * axis
    turned = np.cross(across[:, :-1], across[:, 1:]) @ axis
    angle = np.arctan2(turned, (across[:, :-1] * across[:, 1:]).sum(-1)) * beyond[:, :-1]
    wound = bool(np.median(np.abs(angle.sum(1))) > 2 * math.pi * LEAST_WINDING)
    rest = (np.linalg.norm(edges, axis=-1) * beyond[:, :-1]).sum(1)
    return np.where(wound | (rest < SHORT_END), last, vertex), wound
