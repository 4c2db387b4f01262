"""A hairstyle at rest on the body's scalp."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import torch

from quaffure.body.scalp import texel_index
from quaffure.config import TEXTURE_SIZE
from quaffure.errors import InputError
from quaffure.hair.strands import HELD_PARTS
from quaffure.types import Bool, Float, Int, Tensor


@dataclass(frozen=True, eq=False)
class Groom:
    """Guide strands registered to the body, resampled to a common number of vertices.

    Attributes:
        name: a bundled name, or the stem of its file.
        rest_strands: vertices in the rest groom, on the mean body in its rest pose [m, world].
        root_faces: face of the body under each root.
        root_barycentric: barycentric coordinates of the root in that face.
        root_uv: position on the scalp chart, in the unit square.
        licence: terms of use.
        stiffness_scale: multiple of a human hair's stiffness that every edge shall have, at least 1; 1 without.
        goal_weight: weight with which every edge is held to its posed direction (Eq. 6 with a weight of its own) [J];
            0 is free hair, which all of it is without.
        tie_vertex: vertex in the tie or clip of each strand, -1 for none; the edges before it are held.
    """

    name: str
    rest_strands: Float[Tensor, "s n 3"]
    root_faces: Int[Tensor, " s"]
    root_barycentric: Float[Tensor, "s 3"]
    root_uv: Float[Tensor, "s 2"]
    licence: str = ""
    stiffness_scale: Float[Tensor, "s e"] | None = None
    goal_weight: Float[Tensor, "s e"] | None = None
    tie_vertex: Int[Tensor, " s"] | None = None

    def __repr__(self) -> str:
        return f"<Groom {self.name}: {len(self)} strands of {self.rest_strands.shape[1]} vertices>"

    def _repr_html_(self) -> str:
        """A small picture, for notebooks."""
        # By name: the renderer is above this package, and only a notebook asks for a picture.
        return str(import_module("quaffure.apps.notebook").html_of_groom(self))

    def __len__(self) -> int:
        return len(self.rest_strands)

    @property
    def rest_lengths(self) -> Float[Tensor, "s e"]:
        """Length of every edge at rest (l_rest) [m]."""
        return self.rest_strands.diff(dim=1).norm(dim=-1)

    @property
    def strand_lengths(self) -> Float[Tensor, " s"]:
        """Length of every strand at rest [m]."""
        return self.rest_lengths.sum(dim=1)

    @property
    def held_edges(self) -> Bool[Tensor, "s e"]:
        """Edges before a tie, and those with a goal of their own."""
        held = torch.zeros_like(self.rest_lengths, dtype=torch.bool)
        if self.tie_vertex is not None:
            held |= torch.arange(held.shape[1], device=held.device) < self.tie_vertex[:, None]
        return held if self.goal_weight is None else held | (self.goal_weight > 0)

    def texels(self, size: int = TEXTURE_SIZE) -> Int[Tensor, " s"]:
        """Flat index (row times size plus column) of the texel of each root; row from v, column from u."""
        return texel_index(self.root_uv, size)

    def select(self, strands: Int[Tensor, " m"]) -> "Groom":
        """The groom of some of its strands, in the given order."""
        return self._map_tensors(lambda tensor: tensor[strands])

    def thinned(self, count: int) -> "Groom":
        """The groom of so many of its strands, evenly spaced in their order; all of them where there are fewer.

        Raises:
            InputError: fewer than one.
        """
        if count < 1:
            raise InputError(self.name, "at least one strand", str(count))
        return self.select(torch.linspace(0, len(self) - 1, min(count, len(self))).round().long())

    def to(self, device: torch.device | torch.dtype | str) -> "Groom":
        """The same groom on a device or in a float dtype; the same object if it is there already, so that caches by
        identity find it."""
        if isinstance(device, torch.dtype):
            return self._map_tensors(lambda tensor: tensor.to(device) if tensor.is_floating_point() else tensor)
        if self.rest_strands.device == torch.device(device):
            return self
        return self._map_tensors(lambda tensor: tensor.to(device))

    def arrays(self) -> dict[str, Tensor]:
        """Its tensors by the names of their fields, without those of held parts that it does not have."""
        found: dict[str, Tensor] = {}
        for name in ("rest_strands", "root_faces", "root_barycentric", "root_uv", *HELD_PARTS):
            values = getattr(self, name)
            if values is not None:
                found[name] = values
        return found

    def _map_tensors(self, function: Callable[[Tensor], Tensor]) -> "Groom":
        changes: dict[str, Any] = {name: function(values) for name, values in self.arrays().items()}
        return replace(self, **changes)
