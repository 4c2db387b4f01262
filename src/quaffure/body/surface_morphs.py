"""Changes of a body's surface over a motion, as morph targets of a character make them."""

from dataclasses import dataclass, replace

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
        frames = [self.offsets(slice(frame, frame + 1)) for frame in range(len(self))]
        changes = [float(frame.norm(dim=2).max()) for frame in frames if frame.numel()]
        if not all(change <= LARGEST_CHANGE for change in changes):  # also where one is not finite
            raise InputError(
                source, f"morph targets that move skin by at most {LARGEST_CHANGE:g} m", f"{max(changes):.3g} m"
            )
