"""Held parts of a groom: edges that a tie, a clip or gel holds to their posed direction."""

from dataclasses import replace

import torch

from quaffure.energies.rod import joint_stiffness
from quaffure.hair.groom import Groom
from quaffure.hair.tie_detection import find_ties
from quaffure.types import Bool, Float, Int, RestLengths, Tensor

GOAL_STIFFNESS = 200.0
"""Least weight of a held edge's goal, relative to its bending stiffness."""


def free_goal_weight(rest_lengths: RestLengths, held: Bool[Tensor, "s e"]) -> Float[Tensor, "s e"]:
    """Weight of the goals of held edges that carry no load [J]: `GOAL_STIFFNESS` times a human hair's B."""
    bending, _ = joint_stiffness(rest_lengths, GOAL_STIFFNESS)
    return torch.where(held, bending, 0.0)


def goal_weight_of(groom: Groom) -> Float[Tensor, "s e"]:
    """Weight with which a groom asks for every edge to be held [J]: its own, or a tie's where that is more."""
    tied = free_goal_weight(groom.rest_lengths, replace(groom, goal_weight=None).held_edges)
    return tied if groom.goal_weight is None else torch.maximum(groom.goal_weight.to(tied), tied)


def stiffness_scale_of(groom: Groom) -> Float[Tensor, "s e"]:
    """Multiple of a human hair's stiffness that a groom asks for at every edge."""
    return torch.ones_like(groom.rest_lengths) if groom.stiffness_scale is None else groom.stiffness_scale


def with_ties(groom: Groom, tie_vertex: Int[Tensor, " s"]) -> Groom:
    """The groom with ties and the goals of the edges before them, in addition to goals that it has."""
    tied = replace(groom, tie_vertex=tie_vertex)
    return replace(tied, goal_weight=goal_weight_of(tied))


def with_found_ties(groom: Groom) -> tuple[Groom, str]:
    """The groom with its ties, searched for where it says nothing of any, and a line on them."""
    count = len(groom)
    if groom.tie_vertex is not None:
        return groom, f"ties of the file: {int((groom.tie_vertex >= 0).sum())} of {count} strands are tied"
    tie_vertex, found = find_ties(groom)
    if not found:
        return groom, "no ties found"
    tied = f"{int((tie_vertex >= 0).sum())} of {count} strands are tied (groom import --ties none leaves them free)"
    return with_ties(groom, tie_vertex), f"ties found: {tied}: {', '.join(map(str, found))}"


def released(groom: Groom, strands: Bool[Tensor, " s"]) -> Groom:
    """The groom with some strands free of ties and goals."""
    ties, goals = groom.tie_vertex, groom.goal_weight
    return replace(
        groom,
        tie_vertex=None if ties is None else torch.where(strands, -1, ties),
        goal_weight=None if goals is None else torch.where(strands[:, None], 0.0, goals),
    )


def held_up_to(groom: Groom, strands: Bool[Tensor, " s"], length: float) -> Groom:
    """The groom with some strands held from their roots to the vertex nearest to a length [m] along them."""
    edges = torch.arange(groom.rest_lengths.shape[1]) < _nearest_vertex(groom, length)[:, None]
    goal = free_goal_weight(groom.rest_lengths, edges & strands[:, None])
    return replace(groom, goal_weight=goal if groom.goal_weight is None else torch.maximum(groom.goal_weight, goal))


def tied_at(groom: Groom, strands: Bool[Tensor, " s"], length: float) -> Groom:
    """The groom with the ties and goals of some strands replaced by a tie at a length [m] along them."""
    free = released(groom, strands)
    others = torch.full((len(groom),), -1) if free.tie_vertex is None else free.tie_vertex
    return with_ties(free, torch.where(strands, _nearest_vertex(groom, length), others))


def _nearest_vertex(groom: Groom, length: float) -> Int[Tensor, " s"]:
    """Vertex of each strand nearest to a length [m] along it, not the root; the tip of shorter ones."""
    return 1 + (groom.rest_lengths.cumsum(1) - length).abs().argmin(1)
