"""Cohesion of tails: what holds the hair beyond a tie together, in place of friction and of hair wound around hair.

Eqs. 10 and 11 only push. Strands beyond a tie would slide off the neck to both sides, each by itself, and a ponytail
would open into a curtain at the first bow. Here a tail has a centre line: at knots evenly spaced along it, the mean
of its vertices; in between, c is linear. A vertex that is farther from c than a radius R is pulled back,

    E = sum m k / 2 max(|x - c| - R, 0)^2,    R = a |x - c| at rest + b,

which is zero in the design and does not change when a tail rotates or moves as a whole. Not in the paper.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.energies.rest_state import RestState
from quaffure.hair.groom import Groom
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Int, Positions, Tensor

TIE_SPACING = 0.01
"""Ties of strands nearer to each other than this are one [m]."""
KNOT_SPACING = 0.02
"""Distance of the knots of a centre line [m]."""


class Tails(NamedTuple):
    """The hair beyond the ties of a groom.

    Attributes:
        vertex: index of each vertex among those of all strands.
        knot: index of the last knot before it; the next one follows.
        share: of the way from that knot to the next.
        weight: of a vertex in the means that are its two knots.
        rest_distance: of each vertex from the centre line at rest [m].
    """

    vertex: Int[Tensor, " p"]
    knot: Int[Tensor, " p"]
    share: Float[Tensor, " p"]
    weight: Float[Tensor, "2 p"]
    rest_distance: Float[Tensor, " p"]

    def from_centre(self, positions: Positions) -> Float[Tensor, "b p 3"]:
        """Vectors from the centre lines to the vertices [m]."""
        own = positions.flatten(1, 2)[:, self.vertex]
        knots = own.new_zeros(len(own), int(self.knot.max()) + 2, 3)
        for side, weight in enumerate(self.weight):
            knots = knots.index_add(1, self.knot + side, weight[:, None] * own)
        return own - torch.lerp(knots[:, self.knot], knots[:, self.knot + 1], self.share[:, None])


def tails_of(groom: Groom) -> Tails | None:
    """The tails of a groom; None where nothing is tied, or nothing is beyond the ties."""
    if groom.tie_vertex is None:
        return None
    strands, vertices = groom.rest_strands.shape[:2]
    tied = (groom.tie_vertex > 0) & (groom.tie_vertex < vertices - 1)
    if not tied.any():
        return None
    tie_vertex = groom.tie_vertex.long().clamp(min=0)
    along = torch.nn.functional.pad(groom.rest_lengths.cumsum(1), (1, 0))
    beyond = along - along.gather(1, tie_vertex[:, None])
    bundle = torch.full((strands,), -1).to(tie_vertex)
    bundle[tied] = _bundles(groom.rest_strands[tied, tie_vertex[tied]])
    vertex = (tied[:, None] & (torch.arange(vertices).to(tie_vertex) >= tie_vertex[:, None])).flatten().nonzero()[:, 0]
    of_vertex = bundle[vertex // vertices]
    place = beyond.flatten()[vertex] / KNOT_SPACING
    longest = torch.zeros(int(bundle.max()) + 1).to(place).scatter_reduce(0, of_vertex, place, "amax")
    counts = longest.long() + 2
    first = counts.cumsum(0) - counts
    knot, share = first[of_vertex] + place.long(), place.frac()
    weight = torch.stack([1 - share, share])
    total = torch.zeros(int(counts.sum())).to(place)
    for side in range(2):
        total = total.index_add(0, knot + side, weight[side])
    mean = torch.stack([weight[side] / total[knot + side].clamp(min=1e-12) for side in range(2)])
    tails = Tails(vertex, knot, share, mean, torch.zeros_like(share))
    return tails._replace(rest_distance=tails.from_centre(groom.rest_strands[None])[0].norm(dim=-1))


def _bundles(ties: Float[Tensor, "t 3"]) -> Int[Tensor, " t"]:
    """Number of the tie that each strand goes through."""
    first, second = KDTree(ties.cpu().numpy()).query_pairs(TIE_SPACING, output_type="ndarray").T
    near = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(len(ties), len(ties)))
    return torch.from_numpy(connected_components(near, directed=False)[1]).long().to(ties.device)


@dataclass(frozen=True, eq=False)
class Cohesion(EnergyTerm):
    """The term above.

    Attributes:
        tails: of the one groom that the term is for.
        stiffness: k [1/s^2]; by default two weights for each centimetre.
        swelling: a.
        slack: b [m].
    """

    name = "cohesion"
    equation = "not in the paper"
    metric_unit = "m"

    tails: Tails
    stiffness: float = 2000.0
    swelling: float = 1.5
    slack: float = 2e-3

    def prepare(self, rest: RestState, scene: HairScene) -> Tails:
        """The tails on the scene's device, in its floating type."""
        like = scene.posed
        return Tails(*(part.to(like if part.is_floating_point() else like.device) for part in self.tails))

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        mass = hair.rest.mass.flatten()[hair.prepared[self.name].vertex]
        return 0.5 * self.stiffness * (mass * self.metric(hair, scene).square()).sum(dim=1)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b p"]:
        """Distance beyond R of every vertex [m]."""
        tails: Tails = hair.prepared[self.name]
        distance = tails.from_centre(hair.positions).square().sum(-1).clamp(min=1e-16).sqrt()
        return (distance - self.swelling * tails.rest_distance - self.slack).clamp(min=0)
