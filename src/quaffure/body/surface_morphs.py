"""Changes of a body's surface over a motion, as morph targets of a character make them."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from quaffure.errors import InputError
from quaffure.types import Float, Tensor

LARGEST_CHANGE = 1.0
"""Largest change of the place of a vertex at rest, in any frame [m]."""


@dataclass(frozen=True, eq=False)
class SurfaceMorphs:
    """A surface that changes linearly with weights, which every frame has of its own.

    Attributes:
        directions: change of the vertices of the body at rest, for a weight of 1 [m].
        weights: of every frame [-].
    """

    directions: Float[Tensor, "t v 3"]
    weights: Float[Tensor, "f t"]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.weights)

    def offsets(self, rows: slice) -> Float[Tensor, "f v 3"]:
        """Change of the vertices at rest in some frames [m]."""
        return torch.einsum("ft,tvi->fvi", self.weights[rows], self.directions)

    def select(self, frames: slice) -> "SurfaceMorphs":
        """Some of the frames."""
        return replace(self, weights=self.weights[frames])

    def between(self, position: Float[Tensor, " g"]) -> "SurfaceMorphs":
        """At places between the frames, counted from 0; weights are interpolated linearly."""
        before = position.long().clamp(0, max(len(self) - 2, 0))
        after = (before + 1).clamp(max=len(self) - 1)
        share = (position - before)[:, None].to(self.weights)
        return replace(self, weights=torch.lerp(self.weights[before], self.weights[after], share))

    def check(self, source: str) -> None:
        """Refuse changes that are no change of a head.

        Raises:
            InputError: beyond `LARGEST_CHANGE`, or not finite.
        """
        # One bound for all frames: the sum of what each target moves a vertex by.
        length, most = self.directions.double().norm(dim=2), self.weights.double().abs().amax(0)
        largest = float((length * most[:, None]).sum(0).max()) if length.numel() else 0.0
        if not np.isfinite(largest) or largest > LARGEST_CHANGE:
            raise InputError(
                source, f"morph targets that move skin by at most {LARGEST_CHANGE:g} m", f"{largest:.3g} m"
            )
