"""A hairstyle at rest on the body's scalp."""

from dataclasses import dataclass, replace

import torch

from quaffure.config import TEXTURE_SIZE
from quaffure.types import Float, Int, Tensor


@dataclass(frozen=True, eq=False)
class Groom:
    """Guide strands registered to the body, resampled to a common number of vertices.

    Attributes:
        name: a bundled name, or the stem of the file that it came from.
        rest_strands: vertices in the rest groom, on the mean body in its rest pose [m, world].
        root_faces: face of the body that carries each root.
        root_barycentric: where in that face.
        root_uv: where on the scalp chart, in the unit square.
        licence: the terms of the groom.
    """

    name: str
    rest_strands: Float[Tensor, "s n 3"]
    root_faces: Int[Tensor, " s"]
    root_barycentric: Float[Tensor, "s 3"]
    root_uv: Float[Tensor, "s 2"]
    licence: str = ""

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

    def texels(self, size: int = TEXTURE_SIZE) -> Int[Tensor, " s"]:
        """Flat index (row times size plus column) of the texel that holds each root; row from v, column from u."""
        cell = (self.root_uv * size).long().clamp(0, size - 1)
        return cell[:, 1] * size + cell[:, 0]

    def select(self, strands: Int[Tensor, " m"]) -> "Groom":
        """The groom of some of its strands, in the order given."""
        return replace(
            self,
            rest_strands=self.rest_strands[strands],
            root_faces=self.root_faces[strands],
            root_barycentric=self.root_barycentric[strands],
            root_uv=self.root_uv[strands],
        )

    def to(self, device: torch.device | str) -> "Groom":
        """The same groom on a device; this very one where nothing has to move, so that what is kept for it is found."""
        if self.rest_strands.device == torch.device(device):
            return self
        return replace(
            self,
            rest_strands=self.rest_strands.to(device),
            root_faces=self.root_faces.to(device),
            root_barycentric=self.root_barycentric.to(device),
            root_uv=self.root_uv.to(device),
        )
