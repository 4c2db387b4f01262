"""Input of the groom encoder, Sec. 3.2: every strand in the frame of its root, its size apart from its shape."""

from dataclasses import dataclass

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel
from quaffure.config import TEXTURE_SIZE, VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.hair.groom import Groom
from quaffure.types import Float, Int, Tensor

SHAPE_CHANNELS = 3 * VERTICES_PER_STRAND
TEXTURE_CHANNELS = SHAPE_CHANNELS + 2
"""The 72 of the paper, then the logarithm of a strand's length, then 1 where a strand grows."""
UNIT_LENGTH = 0.1
"""Length whose logarithm is zero in the texture [m]."""
# Shorter strands count as of this length: a logarithm must stay finite [m].
LEAST_LENGTH = 1e-3


@dataclass(frozen=True)
class GroomSample:
    """A groom as the autoencoder reads it.

    Attributes:
        style: name that all samples of one style share.
        features: see `strand_features`; half precision.
        texels: flat index of each strand's texel.
    """

    style: str
    features: Float[Tensor, "s channels"]
    texels: Int[Tensor, " s"]


def sample_of(groom: Groom, body: BodyModel, style: str) -> GroomSample:
    """A groom ready to be encoded, see `groom_texture`."""
    return GroomSample(style, strand_features(groom, body).half(), groom.texels())


def groom_texture(groom: Groom, body: BodyModel) -> Float[Tensor, "1 channels 64 64"]:
    """The encoder's input for a groom.

    Args:
        groom: registered to `body`, at most one strand a texel (`quaffure.load_groom`).

    Raises:
        InputError: not 24 vertices a strand, two strands in one texel, or a root that is not on the scalp.
    """
    texels = groom.texels()
    if texels.unique().numel() != len(groom):
        raise InputError(groom.name, "one strand a texel (`select_guides`)", "several in one")
    return texture_of(strand_features(groom, body), texels)[None]


def strand_features(groom: Groom, body: BodyModel) -> Float[Tensor, "s channels"]:
    """The texture's channels of each strand: vertices from the root, in its frame, in strand lengths; log length; 1.

    Raises:
        InputError: not 24 vertices a strand, or a root that is not on the scalp.
    """
    if groom.rest_strands.shape[1] != VERTICES_PER_STRAND:
        raise InputError(groom.name, f"{VERTICES_PER_STRAND} vertices a strand", f"{groom.rest_strands.shape[1]}")
    lengths = groom.strand_lengths.clamp(min=LEAST_LENGTH)[:, None]
    offsets = (groom.rest_strands - groom.rest_strands[:, :1]) @ root_frames(groom, body)
    log_length = (lengths / UNIT_LENGTH).log()
    return torch.cat([offsets.flatten(1) / lengths, log_length, torch.ones_like(log_length)], dim=1)


def texture_of(features: Float[Tensor, "s channels"], texels: Int[Tensor, " s"]) -> Float[Tensor, "channels 64 64"]:
    """Features of strands at their texels, zero elsewhere; a texel's channels lie next to each other in memory."""
    texture = features.new_zeros(TEXTURE_SIZE**2, features.shape[1]).index_copy(0, texels, features)
    return texture.mT.unflatten(1, (TEXTURE_SIZE, TEXTURE_SIZE))


def strands_from_features(
    features: Float[Tensor, "s channels"], groom: Groom, body: BodyModel
) -> Float[Tensor, "s n 3"]:
    """Strands [m, world] of features, from the roots of a groom: undoes `strand_features`.

    Raises:
        InputError: a root is not on the scalp.
    """
    offsets = features[:, :SHAPE_CHANNELS].unflatten(1, (VERTICES_PER_STRAND, 3))
    lengths = UNIT_LENGTH * features[:, SHAPE_CHANNELS, None, None].exp()
    return groom.rest_strands[:, :1] + (lengths * offsets) @ root_frames(groom, body).mT


def root_frames(groom: Groom, body: BodyModel) -> Float[Tensor, "s 3 3"]:
    """Orthonormal frames on the scalp of the rest body, columns: along u, along v, outwards (world_from_root).

    Unlike the frames of single triangles (`posing.triangle_frames`), which turn from one triangle to the next
    by any angle, they follow the chart: strands of one style have similar features.

    Raises:
        InputError: a root is not on the scalp.
    """
    chart, corners = body.scalp, body.faces[body.scalp.faces]
    along_u = torch.zeros_like(body.rest_vertices)
    for corner in range(3):
        along_u.index_add_(
            0, corners[:, corner], _gradient_of_u(body.rest_vertices[corners], chart.uv.to(body.rest_vertices))
        )
    normals = angle_weighted_vertex_normals(body.rest_vertices[None], corners)[0]
    if not bool(torch.isin(groom.root_faces, chart.faces).all()):
        raise InputError(groom.name, "roots on the scalp", "roots elsewhere")
    carriers = body.faces[groom.root_faces]
    weights = groom.root_barycentric[..., None]
    normal = normalize((weights * normals[carriers]).sum(1), dim=-1)
    u = (weights * along_u[carriers]).sum(1)
    u = normalize(u - (u * normal).sum(-1, keepdim=True) * normal, dim=-1)
    return torch.stack([u, torch.linalg.cross(normal, u), normal], dim=-1)


def _gradient_of_u(triangles: Float[Tensor, "f 3 3"], uv: Float[Tensor, "f 3 2"]) -> Float[Tensor, "f 3"]:
    """Unit directions in which the chart's u grows fastest on each triangle."""
    edges = triangles[:, 1:] - triangles[:, :1]
    rise = uv[:, 1:, :1] - uv[:, :1, :1]
    return normalize((torch.linalg.pinv(edges) @ rise)[..., 0], dim=-1)
