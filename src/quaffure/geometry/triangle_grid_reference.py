"""Torch twin of `quaffure.geometry.triangle_grid`."""

import torch

from quaffure.geometry.mesh import face_normals
from quaffure.geometry.triangle_grid import EDGE_TOLERANCE, FLAT, NONE, TIE
from quaffure.types import Float, Int, Tensor

_REFERENCE_PAIRS = 4_000_000  # point-face pairs that the twin holds in memory at once


def nearest_triangle_in_band_reference(
    points: Float[Tensor, "p 3"], vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "k 3"], band: Float[Tensor, "k 2"]
) -> tuple[Float[Tensor, " p"], Int[Tensor, " p"]]:
    """Torch twin of `nearest_triangle_in_band`: every point against every face.

    Returns:
        Height above the nearest face [m], and that face; 1 and `NONE` in the band of none.
    """
    chunk = max(1, _REFERENCE_PAIRS // len(faces))
    parts = [_nearest_of_all(part, vertices[faces], band) for part in points.split(chunk)]
    return torch.cat([height for height, _ in parts]), torch.cat([face for _, face in parts])


def _nearest_of_all(
    points: Float[Tensor, "p 3"], corners: Float[Tensor, "k 3 3"], band: Float[Tensor, "k 2"]
) -> tuple[Float[Tensor, " p"], Int[Tensor, " p"]]:
    keys, height = band_key(points[:, None], corners, band)
    key, nearest = keys.min(dim=1)
    chosen = height.gather(1, nearest[:, None])[:, 0]
    return torch.where(key < 1, chosen, 1), torch.where(key < 1, nearest, NONE)


def band_key(
    points: Float[Tensor, "*#n 3"], corners: Float[Tensor, "*#n 3 3"], band: Float[Tensor, "*#n 2"]
) -> tuple[Float[Tensor, "*n"], Float[Tensor, "*n"]]:
    """What faces are compared by, 1 where a point is out of a face's band, and the height above the face [m]."""
    a, b, c = corners.unbind(dim=-2)
    length, normal = (b - a).norm(dim=-1), face_normals(corners)
    along = (b - a) / (length[..., None] + 1e-12)
    across = torch.linalg.cross(normal, along)
    flat = torch.linalg.cross(b - a, c - a).norm(dim=-1) < 2 * FLAT
    offset = points - a
    u, v, height = ((offset * direction).sum(-1) for direction in (along, across, normal))
    x, y = ((c - a) * along).sum(-1), ((c - a) * across).sum(-1)
    in_plane = (u - u.clamp(min=0).minimum(length)).square() + v.square()
    for start, end_x in ((0 * length, x), (length, x - length)):
        share = ((u - start) * end_x + v * y) / (end_x.square() + y.square() + 1e-24)
        share = share.clamp(0, 1)
        in_plane = in_plane.minimum((u - start - share * end_x).square() + (v - share * y).square())
    within = torch.minimum(v, torch.minimum(u * y - v * x, (x - length) * v - y * (u - length)))
    in_plane = torch.where(within < 0, in_plane, 0)
    in_band = (height >= -band[..., 0]) & (height <= band[..., 1]) & (in_plane <= EDGE_TOLERANCE**2) & ~flat
    return torch.where(in_band, in_plane + TIE * height.square(), 1), height
