"""Held parts of a groom: edges that a tie, a clip or gel holds to their posed direction."""

from dataclasses import replace

import torch

from quaffure.energies.rod import BENDING_STIFFNESS, joint_lengths
from quaffure.hair.groom import Groom
from quaffure.types import Bool, Float, Int, RestLengths, Tensor

GOAL_STIFFNESS = 50.0
"""Least weight of a held edge's goal, relative to its bending stiffness."""


def free_goal_weight(rest_lengths: RestLengths, held: Bool[Tensor, "s e"]) -> Float[Tensor, "s e"]:
    """Weight of the goals of held edges that carry no load [J]: `GOAL_STIFFNESS` times a human hair's B."""
    return torch.where(held, GOAL_STIFFNESS * BENDING_STIFFNESS / joint_lengths(rest_lengths), 0.0)


def goal_weight_of(groom: Groom) -> Float[Tensor, "s e"]:
    """Weight with which a groom asks for every edge to be held [J]: its own, or a tie's where that is more."""
    tied = free_goal_weight(groom.rest_lengths, replace(groom, goal_weight=None).held_edges)
    return tied if groom.goal_weight is None else torch.maximum(groom.goal_weight.to(tied), tied)


def stiffness_scale_of(groom: Groom) -> Float[Tensor, "s e"]:
    """Multiple of a human hair's stiffness that a groom asks for at every edge."""
    return torch.ones_like(groom.rest_lengths) if groom.stiffness_scale is None else groom.stiffness_scale


def with_ties(groom: Groom, tie_vertex: Int[Tensor, " s"]) -> Groom:
    """The groom with ties, and the goals of the edges before them. Other goals are dropped."""
    tied = replace(groom, goal_weight=None, tie_vertex=tie_vertex)
    return replace(tied, goal_weight=goal_weight_of(tied))
