"""A groom from one body to another: each root stays at its place on the scalp chart.

Strands go along with a scale for each axis and a translation, fitted to the two scalps by their charts, and are then
moved so that each begins at its root; one that is tied keeps its tie. Then they are projected out of the body.
"""

from dataclasses import replace

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.scalp import ScalpChart
from quaffure.hair.clearance import pushed_out_smoothly
from quaffure.hair.folds import without_folds
from quaffure.hair.groom import Groom
from quaffure.hair.posing import rest_roots
from quaffure.hair.scalp_texture import select_guides
from quaffure.types import Float, Int, Tensor

GRID = 24
"""Places along each side of the chart at which two scalps are compared."""


def transfer_groom(groom: Groom, source: BodyModel, target: BodyModel) -> Groom:
    """The groom on another body.

    Args:
        groom: registered to `source`.
    """
    faces, barycentric = _located(groom.root_uv, target.scalp)
    corners = target.rest_vertices[target.faces[faces]]
    roots = (barycentric[..., None] * corners).sum(-2)
    scale, shift = _scalp_affinity(source, target)
    moved = scale * groom.rest_strands + shift
    begin = scale * rest_roots(groom, source) + shift
    moved = moved + _kept_share(groom)[..., None] * (roots - begin)[:, None]
    moved = pushed_out_smoothly(moved, target.rest_surface)
    moved[:, 0] = roots
    uv = target.scalp.uv_at(faces, barycentric)
    transferred = replace(
        groom, rest_strands=without_folds(moved), root_faces=faces, root_barycentric=barycentric, root_uv=uv
    )
    return select_guides(transferred)


def _located(uv: Float[Tensor, "s 2"], chart: ScalpChart) -> tuple[Int[Tensor, " s"], Float[Tensor, "s 3"]]:
    """Face and barycentric coordinates of places on a chart; beyond its rim those of the nearest triangle's middle."""
    faces, barycentric = chart.locate(uv)
    beyond = (faces < 0).nonzero()[:, 0]
    nearest = torch.cdist(uv[beyond], chart.uv.mean(1)).argmin(1)
    faces = faces.index_copy(0, beyond, chart.faces[nearest])
    middle = torch.full((len(beyond), 3), 1 / 3).to(barycentric)
    return faces, barycentric.index_copy(0, beyond, middle)


def _scalp_affinity(source: BodyModel, target: BodyModel) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Scale along each axis and shift [m] that take points of one scalp to those of the other at the same places."""
    line = (torch.arange(GRID) + 0.5) / GRID
    uv = torch.stack(torch.meshgrid(line, line, indexing="ij"), dim=-1).reshape(-1, 2)
    points = []
    on_both = (source.scalp.locate(uv)[0] >= 0) & (target.scalp.locate(uv)[0] >= 0)
    for body in (source, target):
        faces, barycentric = body.scalp.locate(uv[on_both])
        points.append((barycentric[..., None] * body.rest_vertices[body.faces[faces]]).sum(-2))
    first, second = points
    centred = first - first.mean(0)
    scale = (centred * (second - second.mean(0))).sum(0) / centred.square().sum(0)
    return scale, second.mean(0) - scale * first.mean(0)


def _kept_share(groom: Groom) -> Float[Tensor, "s n"]:
    """Share of its root's shift that each vertex takes: all of it, but from the root to a tie less and less."""
    share = torch.ones(groom.rest_strands.shape[:2])
    if groom.tie_vertex is None:
        return share
    before = groom.tie_vertex[:, None]
    index = torch.arange(share.shape[1])
    return torch.where(before > 0, (1 - index / before.clamp(min=1)).clamp(min=0), share)
